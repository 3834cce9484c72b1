"""Priors: what is believed beside the data. Each file here is one."""
