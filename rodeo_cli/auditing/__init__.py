"""`rodeo audit`: an organization's verdicts, judged again by anybody who has its chain, store and lab.

reading     the attempts that the chain tells of, and what it said of each when it was judged
judging     what is wrong with a verdict today, and why
bounds      what a sample says of all verdicts
page        the findings as a page that loads nothing

Nothing here opens a key or asks a process of the site.
"""
