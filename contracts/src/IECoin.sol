// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {ERC20} from "@openzeppelin/contracts/token/ERC20/ERC20.sol";
import {ERC20Permit} from "@openzeppelin/contracts/token/ERC20/extensions/ERC20Permit.sol";
import {ERC20Votes} from "@openzeppelin/contracts/token/ERC20/extensions/ERC20Votes.sol";
import {Nonces} from "@openzeppelin/contracts/utils/Nonces.sol";

/// @title The token in which work is paid: ERC-20 with permit (EIP-2612) and votes (ERC-5805), 18 decimals.
/// @notice Nobody owns it; its whole supply is minted to the first holders when it is deployed.
contract IECoin is ERC20, ERC20Permit, ERC20Votes {
    error LengthMismatch(uint256 holders, uint256 amounts);

    constructor(address[] memory holders, uint256[] memory amounts)
        ERC20("IECoin", "IEC")
        ERC20Permit("IECoin")
    {
        if (holders.length != amounts.length) {
            revert LengthMismatch(holders.length, amounts.length);
        }
        for (uint256 i = 0; i < holders.length; ++i) {
            _mint(holders[i], amounts[i]);
        }
    }

    /// @inheritdoc ERC20Permit
    function nonces(address owner) public view override(ERC20Permit, Nonces) returns (uint256) {
        return super.nonces(owner);
    }

    function _update(address from, address to, uint256 amount) internal override(ERC20, ERC20Votes) {
        super._update(from, to, amount);
    }
}
