// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {ERC20} from "@openzeppelin/contracts/token/ERC20/ERC20.sol";
import {ERC20Permit} from "@openzeppelin/contracts/token/ERC20/extensions/ERC20Permit.sol";

/// @title The token in which work is paid: ERC-20 with permit (EIP-2612), 18 decimals.
/// @notice Nobody owns it; its whole supply is minted to the first holders when it is deployed. Tokens have no
/// votes, so that no task pays for checkpoints.
contract IECoin is ERC20, ERC20Permit {
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
}
