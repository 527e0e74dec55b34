"""What crosses the Zenoh link: messages, key expressions, seals, the files of TLS, refusals."""
