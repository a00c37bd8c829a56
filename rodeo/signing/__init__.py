"""Keys, and what is signed with them: the curve, typed data, keystores and wallets.

What a signature means is elsewhere: `rodeo.evidence`, `rodeo.witness`, `rodeo.chain.signed_requests`.
"""
