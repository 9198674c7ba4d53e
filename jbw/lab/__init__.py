"""Tests of the procedure: do its intervals contain the truth, and do its samplers agree?"""
