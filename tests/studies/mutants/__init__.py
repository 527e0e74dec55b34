"""The mutation test: which small changes of the product the tests of `make test` notice."""
