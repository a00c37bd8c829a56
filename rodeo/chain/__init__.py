"""The organization's contracts from Python: one deployment's views, calls, governance, signed requests.

`contracts/` has their types and events, `node/` what talks with a node, `artifacts/` the ABI and bytecode.
It works with any Ethereum JSON-RPC node and keeps no state: `services.bridge` queues and retries.
"""
