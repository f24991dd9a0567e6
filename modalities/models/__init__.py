"""The models of speech and hands: where they come from, which are in use."""
