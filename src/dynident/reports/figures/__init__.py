"""The figures of reports: each function draws results as one inline SVG."""
