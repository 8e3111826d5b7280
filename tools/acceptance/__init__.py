"""What takes too long for every commit: does the program last, recover and stay accurate?"""
