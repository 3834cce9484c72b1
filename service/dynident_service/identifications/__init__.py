"""Identified models: their ladder of effects, verdict and exports; batches of identifications."""
