"""Readers and writers of omm's files; every mistake is told with file, key and what to do."""
