"""Figures of a report, each a function from results to one inline SVG."""
