"""The organization's contracts from Python: typed views, encoded calls, typed events and named errors.

    deployment.py   Deployment: which contracts are where, one record per chain
    client.py       ChainClient: views, events and transactions of one deployment on one node
    calls.py        what to send to do something: Calls, and OrganizationCalls in the organization's name
    governance.py   decisions after a delay, with votes or without: proposals, and what their calls would do
    registry.py     where organizations are founded, at addresses known beforehand, and listed
    logs.py         events as the chain logs them
    abi.py          the contracts' enums and structs, generated
    contract_calls.py  their calls, generated
    events.py       one record type per contract event, generated
    types.py        how their values look in Python: amounts, kinds as text, roles
    errors.py       ChainError and what is below it
    translation.py  what nodes and web3.py raise becomes these errors; revert data becomes ContractReverted
    artifacts/      ABI and bytecode, built from contracts/ (`make contracts`)

It works with any Ethereum JSON-RPC node and keeps no state: it neither queues nor retries.
"""
