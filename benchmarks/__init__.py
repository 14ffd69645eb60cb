"""The cases of the tests, timed. Each module prints its own table; nothing here is a test."""
