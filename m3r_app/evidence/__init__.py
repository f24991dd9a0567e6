"""What judges a flight without the code that flew it: a geometry of its own, from the record to a verdict. Pure.

Of `safety` only the data types are known here (`safety.vocabulary`, `safety.limits`); import-linter holds that.
"""
