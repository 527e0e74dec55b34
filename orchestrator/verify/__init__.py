"""Check a certificate against its evidence, believing neither the database nor the certificate."""
