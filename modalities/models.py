class ModelError(ValueError):
    """A voice model that is missing or cannot be used; one sentence that names it and says what to do."""
