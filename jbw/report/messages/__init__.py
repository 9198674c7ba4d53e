"""The catalogue: every sentence that jbw writes, its explanation and its remedy, by topic.

Rooms compute values; a sentence with values in it is written here. Nothing here computes more than
the choice between two sentences, and nothing but `errors`, `quantities` and `units` is imported.
"""
