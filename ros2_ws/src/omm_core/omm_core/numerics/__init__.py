"""Small numerical tools that every room of the core shares."""
