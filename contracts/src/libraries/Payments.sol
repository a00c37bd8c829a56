// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";

/// @title Payments that whoever is paid cannot make fail.
library Payments {
    /// @notice The gas of a payment: a recipient that a token with hooks calls holds up neither party.
    uint256 internal constant GAS = 200_000;

    /// @notice Returns whether the token moved the amount: SafeERC20.trySafeTransfer with bounded gas and answer.
    /// @param token in which it is paid
    /// @param to who is paid
    /// @param amount in the token's smallest unit
    function pay(IERC20 token, address to, uint256 amount) internal returns (bool success) {
        bytes memory request = abi.encodeCall(IERC20.transfer, (to, amount));
        assembly ("memory-safe") {
            success := call(GAS, token, 0, add(request, 32), mload(request), 0, 32)
            // Nothing, or true.
            if returndatasize() {
                success := and(success, and(gt(returndatasize(), 31), eq(mload(0), 1)))
            }
        }
    }
}
