"""Agents of the environments behind one interface: built-in, guidance laws, policies, files."""
