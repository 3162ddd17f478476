"""Score text-to-motion methods: evaluators, metrics, sources of motion and the protocol that joins them."""
