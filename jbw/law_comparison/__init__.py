"""Laws of the joint compared on one campaign: which do its data ask for, and how surely?"""
