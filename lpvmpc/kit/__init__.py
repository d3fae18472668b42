"""What all parts share and no part is about: files, tables, provenance, command lines."""
