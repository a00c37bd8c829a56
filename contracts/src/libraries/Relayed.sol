// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

/// @title Calls that somebody else sends (ERC-2771).
library Relayed {
    /// @notice Returns the caller, or the signer for whom the forwarder calls: it has appended that account's address.
    /// @param forwarder the only contract that is believed; it always appends an address
    function sender(address forwarder) internal view returns (address account) {
        account = msg.sender;
        if (account != forwarder) return account;
        // By hand: 300 bytes less of code than a slice.
        assembly ("memory-safe") {
            account := shr(96, calldataload(sub(calldatasize(), 20)))
        }
    }
}
