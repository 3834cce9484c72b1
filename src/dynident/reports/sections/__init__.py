"""Sections of a report, a module for one or a few: they turn results into a template's content."""
