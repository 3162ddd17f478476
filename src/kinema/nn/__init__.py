"""Hold the pure building blocks of the networks: convolutions, attention, embeddings, modulation."""
