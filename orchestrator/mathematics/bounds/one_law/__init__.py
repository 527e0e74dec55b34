"""Bounds of one law from independent samples: its mean, risk, CVaR, quantile and failure probability."""
