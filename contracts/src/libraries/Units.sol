// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";

/// @title Amounts as 57-bit numbers, so that two of them and their references fit in one storage word.
/// @notice Prices are whole units, so `price <= reward` holds if and only if it holds for the weights.
library Units {
    /// @notice The token's smallest unit times 10^9: a billionth of a token with 18 decimals.
    uint256 internal constant UNIT = 1 gwei;

    /// @notice The greatest price: 144 million tokens with 18 decimals.
    uint256 internal constant MAX = ((1 << 57) - 2) * UNIT;

    function isPrice(uint256 amount) internal pure returns (bool) {
        return amount <= MAX && amount % UNIT == 0;
    }

    /// @notice The amount in whole units, rounded down, as a weight.
    function weight(uint256 amount) internal pure returns (uint64) {
        return uint64(Math.min(amount, MAX) / UNIT);
    }
}
