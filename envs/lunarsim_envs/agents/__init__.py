"""Agents behind one interface: built-in agents, guidance laws, policies, networks in files."""
