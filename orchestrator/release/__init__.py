"""The place of certificates in a release process: decisions, and what they rest on."""
