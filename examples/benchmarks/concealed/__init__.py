"""Sealed cases with concealed effects: generator, seal, scorer, baselines. Nothing here imports pwaid."""
