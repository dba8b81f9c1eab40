"""Systems of known truth, named author-year-system, used by tests, examples and docs alike."""
