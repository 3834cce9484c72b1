"""From recordings to an identified model, and on: with more effects, with fewer, with other choices, in files."""
