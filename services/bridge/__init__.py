"""The bridge: the only process that talks to the chain for the others.

process.py       attaches to node and contracts, keeps following, reports why when it cannot
follower.py      new blocks -> index -> events on the bus
index.py         the organization as its events tell it; schema.py has the tables
queries.py       `state/...`: answers from the index
commands.py      `wallet/<participant>/...`: what each command checks, calls and replies
relaying.py      what one participant signs and another one sends
transactions.py  the transactions of all wallets, journaled before they are sent
journal.py       what a crash must not forget
"""
