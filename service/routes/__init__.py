"""A file per resource: parse, one call, reply."""
