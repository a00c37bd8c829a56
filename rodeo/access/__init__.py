"""The people who use a site's console: accounts, sessions, tokens and roles.

Rights on the bus are in `rodeo.site.topics`, roles on chain in `rodeo.chain`.
"""
