"""Adaptive refinement: which particles are split, into what, and what becomes of their bonds."""
