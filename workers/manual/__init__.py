"""A worker whose rollouts a person drives: a page shows each request, and takes the log of its test."""
