"""What `mmnn prove` shows: numbers for machines, tables for a terminal, figures.

Proof -> numbers (JSON), text (terminal), figures (pictures, also in the gallery)
"""
