"""Figures of reports and notebooks, each one inline SVG."""
