"""The procedure under test: do its intervals contain the truth, and do its samplers agree?"""
