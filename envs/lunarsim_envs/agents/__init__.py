"""Agents with one interface: built-in agents, guidance laws, policies, networks."""
