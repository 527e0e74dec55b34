"""The diagrams of docs/architecture.md; `python -m tests.architecture` draws them."""
