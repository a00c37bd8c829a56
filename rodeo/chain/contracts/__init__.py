"""The contracts as Python that mypy knows: enums, structs, events, generated from the built ABI.

Nothing here asks a node. Generated calls are in `rodeo.chain.contract_calls`.
"""
