"""A report on paper: its page set anew by Typst."""
