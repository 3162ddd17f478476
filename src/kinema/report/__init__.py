"""Turn results into cells, text and pages; reads results and computes nothing."""
