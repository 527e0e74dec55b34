"""What a campaign finds: facts, the certificate, the verdict, what is known so far."""
