"""Showing: the page, its server and recordings, headless pictures and films."""
