// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";

/// @title Amounts, and the levels by which prices and rewards are compared.
/// @notice A level has three decimal digits, so that a kind has few of them (14 bits): whoever offers services at odd
/// prices cannot make the search for others' services much longer. Prices are rounded up and rewards down. So a
/// service that is found never costs more than the reward, and amounts of three digits are compared exactly.
library Units {
    /// @notice The token's smallest unit times 10^9: a billionth of a token with 18 decimals.
    uint256 internal constant UNIT = 1 gwei;

    /// @notice The greatest price: 144 million tokens with 18 decimals.
    uint256 internal constant MAX = ((1 << 57) - 2) * UNIT;

    function isPrice(uint256 amount) internal pure returns (bool) {
        return amount <= MAX && amount % UNIT == 0;
    }

    /// @dev Levels of each power of ten: 100 to 999.
    uint256 private constant STEPS = 900;

    /// @notice The level of a reward: the highest that it pays for.
    function levelOf(uint256 reward) internal pure returns (uint64) {
        uint256 units = Math.min(reward, MAX) / UNIT;
        uint256 exponent = _exponent(units);
        return uint64(exponent * STEPS + units / 10 ** exponent);
    }

    /// @notice The level of a price: the lowest that pays for it.
    function levelFor(uint256 price) internal pure returns (uint64) {
        uint256 units = price / UNIT;
        uint256 exponent = _exponent(units);
        return uint64(exponent * STEPS + Math.ceilDiv(units, 10 ** exponent));
    }

    /// @notice The highest price of a level.
    function priceOf(uint64 level) internal pure returns (uint256) {
        uint256 exponent = level < 1000 ? 0 : (level - 100) / STEPS;
        // The division finds the exponent, whose remainder is the level's digits.
        // slither-disable-next-line divide-before-multiply
        return (level - exponent * STEPS) * 10 ** exponent * UNIT;
    }

    function _exponent(uint256 units) private pure returns (uint256) {
        return units < 1000 ? 0 : Math.log10(units) - 2;
    }
}
