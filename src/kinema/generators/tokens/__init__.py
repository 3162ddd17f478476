"""Hold what the methods on codes share: requests, embeddings, transformers, choices."""
