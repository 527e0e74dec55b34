"""The claims of a finished campaign: the certificate, its signature and its verification."""
