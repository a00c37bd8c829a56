// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {ERC20} from "@openzeppelin/contracts/token/ERC20/ERC20.sol";
import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {ERC20Votes} from "@openzeppelin/contracts/token/ERC20/extensions/ERC20Votes.sol";
import {ERC20Wrapper} from "@openzeppelin/contracts/token/ERC20/extensions/ERC20Wrapper.sol";
import {EIP712} from "@openzeppelin/contracts/utils/cryptography/EIP712.sol";
import {Time} from "@openzeppelin/contracts/utils/types/Time.sol";

/// @title Votes by what somebody owns: a wrapped token for each token that is set aside (`depositFor`, `withdrawTo`).
/// @notice What is in escrow or in anybody's pocket does not vote, and moving the token itself costs no checkpoint.
/// Holders vote for themselves unless they delegate.
contract WrappedVotes is ERC20, ERC20Wrapper, ERC20Votes {
    constructor(IERC20 token)
        ERC20("Voting IECoin", "vIEC")
        ERC20Wrapper(token)
        EIP712("Voting IECoin", "1")
    {}

    function decimals() public view override(ERC20, ERC20Wrapper) returns (uint8) {
        return super.decimals();
    }

    /// @dev Seconds, as MemberVotes.
    function clock() public view override returns (uint48) {
        return Time.timestamp();
    }

    // solhint-disable-next-line func-name-mixedcase
    function CLOCK_MODE() public pure override returns (string memory) {
        return "mode=timestamp";
    }

    function _update(address from, address to, uint256 amount) internal override(ERC20, ERC20Votes) {
        if (to != address(0) && delegates(to) == address(0)) _delegate(to, to);
        super._update(from, to, amount);
    }
}
