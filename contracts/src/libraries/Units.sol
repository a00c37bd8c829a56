// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {IERC20Metadata} from "@openzeppelin/contracts/token/ERC20/extensions/IERC20Metadata.sol";
import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";

/// @title Amounts, and the levels by which prices and rewards are compared.
/// @notice A level has three decimal digits, so that a kind has few of them (14 bits): whoever offers services at odd
/// prices cannot make the search for others' services much longer. Prices are rounded up and rewards down. So a
/// service that is found never costs more than the reward, and amounts of three digits are compared exactly.
/// Prices are multiples of a unit, a billionth of a token, or the smallest unit of a token that has fewer decimals.
library Units {
    /// @notice Amounts are made for tokens with `min` to `max` decimals.
    error UnsupportedDecimals(IERC20 token, uint8 decimals, uint8 min, uint8 max);

    /// @notice A token with fewer has no cents, in which people and services name prices.
    uint8 internal constant MIN_DECIMALS = 2;
    /// @notice A price of a token with more would not fit in its 88 bits.
    uint8 internal constant MAX_DECIMALS = 18;

    /// @notice The greatest price, in units: 144 million tokens with 9 decimals or more.
    uint256 private constant MAX = (1 << 57) - 2;

    /// @notice The unit of prices, in the token's smallest unit, and how many make a token. Reverts with
    /// UnsupportedDecimals, and without a reason if the token does not say how many it has.
    function unitOf(IERC20 token) internal view returns (uint256 unit, uint256 perToken) {
        uint8 decimals = IERC20Metadata(address(token)).decimals();
        if (decimals < MIN_DECIMALS || decimals > MAX_DECIMALS) {
            revert UnsupportedDecimals(token, decimals, MIN_DECIMALS, MAX_DECIMALS);
        }
        unit = decimals > 9 ? 10 ** (decimals - 9) : 1;
        perToken = 10 ** decimals / unit;
    }

    /// @notice The greatest price, in the token's smallest unit.
    function max(uint256 unit) internal pure returns (uint256) {
        return MAX * unit;
    }

    function isPrice(uint256 amount, uint256 unit) internal pure returns (bool) {
        return amount <= max(unit) && amount % unit == 0;
    }

    /// @dev Levels of each power of ten: 100 to 999.
    uint256 private constant STEPS = 900;

    /// @notice A reward in whole units, or the greatest price where it is more: it pays for the same prices.
    function wholeOf(uint256 reward, uint256 unit) internal pure returns (uint64) {
        return uint64(Math.min(reward / unit, MAX));
    }

    /// @notice The level of a reward: the highest that it pays for.
    function levelOf(uint256 reward, uint256 unit) internal pure returns (uint64) {
        uint256 units = wholeOf(reward, unit);
        uint256 exponent = _exponent(units);
        return uint64(exponent * STEPS + units / 10 ** exponent);
    }

    /// @notice The level of a price: the lowest that pays for it.
    function levelFor(uint256 price, uint256 unit) internal pure returns (uint64) {
        uint256 units = price / unit;
        uint256 exponent = _exponent(units);
        return uint64(exponent * STEPS + Math.ceilDiv(units, 10 ** exponent));
    }

    function _exponent(uint256 units) private pure returns (uint256) {
        return units < 1000 ? 0 : Math.log10(units) - 2;
    }
}
