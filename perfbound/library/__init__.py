"""perfbound as a library, for notebooks and scripts: a thin layer over `orchestrator`, which decides everything."""
