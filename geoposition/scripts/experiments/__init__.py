"""The seed documents' experiments: their tables, ours beside them, and the bound."""
