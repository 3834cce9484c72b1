"""Types of HTTP bodies and answers: the contract."""
