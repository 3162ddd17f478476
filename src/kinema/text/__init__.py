"""Hold frozen text encoders behind one callable, their on-disk cache, word vectors and token tables."""
