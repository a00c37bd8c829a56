"""What the console and the command line show alike: amounts, times and rules in words, earnings.

No pages and no tables. Verdicts in words are in `rodeo.judging.verdicts`.
"""
