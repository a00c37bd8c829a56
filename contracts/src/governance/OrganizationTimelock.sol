// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {
    AccessControlDefaultAdminRules
} from "@openzeppelin/contracts/access/extensions/AccessControlDefaultAdminRules.sol";
import {TimelockController} from "@openzeppelin/contracts/governance/TimelockController.sol";

/// @title The administrator of an organization that decides by votes: what was decided happens after a delay, which
/// everybody can see running.
/// @notice Only the governor schedules and cancels; anybody executes. Nobody administers it but itself.
contract OrganizationTimelock is TimelockController {
    constructor(uint256 delay, address governor)
        TimelockController(delay, _only(governor), _only(address(0)), address(0))
    {}

    /// @notice Take over from an administrator who has named this contract as the next one.
    function acceptAdministration(AccessControlDefaultAdminRules organization) external {
        organization.acceptDefaultAdminTransfer();
    }

    function _only(address account) private pure returns (address[] memory accounts) {
        accounts = new address[](1);
        accounts[0] = account;
    }
}
