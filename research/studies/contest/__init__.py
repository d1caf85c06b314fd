"""The contest's document and the search for the learners' settings."""
