"""Filmstrips, films and contact sheets, from recorded states."""
