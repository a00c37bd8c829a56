"""Talk with an Ethereum node: requests, answers, habits of providers, fees, transactions, errors.

It knows no organization. Views and calls of one deployment are in `rodeo.chain`.
"""
