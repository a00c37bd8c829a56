"""The local chain: py-evm (set up by eth-tester) behind Ethereum JSON-RPC, kept in one SQLite file.

    server.py   JSON-RPC 2.0 over HTTP: framing, batches, size limits
    methods.py  the table of method names -> LocalChain
    codec.py    hex encodings and the shapes of blocks, transactions, receipts and logs
    local_chain.py the chain itself: validate, execute, mine, query
    store.py    what survives: state, blocks and the log index, one SQLite transaction per block
    record.py   no new chain begins where the site's contracts are on one that is lost
    anvil.py    the same URL served by an anvil child process instead

Any other node replaces all of this by its URL alone (`chain.backend = "external"`).
"""
