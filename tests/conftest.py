"""The root of the tests: every folder of them can import the helpers that lie here."""
