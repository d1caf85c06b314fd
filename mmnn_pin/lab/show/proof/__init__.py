"""What `mmnn prove` shows: numbers for machines, tables for a terminal, figures.

numbers for JSON, text for a terminal, figures as pictures: each takes the proof, none another's output
"""
