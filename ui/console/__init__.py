"""The operator's console in a terminal. Source: paper III-A (console modality), design "Command line"."""
