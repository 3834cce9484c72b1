"""Results as tables, sentences and labels, each worded once: terminal, notebook, report, HTTP and page render these."""
