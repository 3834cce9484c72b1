"""The sections of a report, one module each: from results to what a template is filled with."""
