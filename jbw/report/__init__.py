"""Figures and the one-file page; reads results, computes none."""
