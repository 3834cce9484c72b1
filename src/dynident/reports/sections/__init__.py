"""The sections of a report, one module each: they turn results into the content that a template shows."""
