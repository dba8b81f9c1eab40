"""Explain why a simulator and recordings differ: locate, name, model, show the gain, or refuse."""
