"""The certificate: from what a finished campaign knows to the document."""
