"""Verification of a certificate against its evidence; neither the database nor the certificate is trusted."""
