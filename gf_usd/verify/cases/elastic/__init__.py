"""Elastic bodies, compared with closed-form and finite element solutions."""
