"""Elastic bodies against closed forms and finite elements."""
