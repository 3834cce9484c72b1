"""Models: which rows W has. Each file here is one."""
