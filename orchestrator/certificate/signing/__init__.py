"""The signature of a certificate, and the keys for it."""
