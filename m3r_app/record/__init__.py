"""The flight record and what is made of it: summary, and Foxglove's views of it."""
