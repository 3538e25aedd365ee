"""Files that describe work: YAML with line and column, validation, keys, templates, checks."""
