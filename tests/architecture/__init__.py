"""The diagrams of docs/architecture.md, drawn from the tables of the two cores: `python -m tests.architecture`."""
