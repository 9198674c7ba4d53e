"""The procedure under test: do its intervals hold the truth, and do its samplers agree?"""
