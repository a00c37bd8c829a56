// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {
    AccessControlDefaultAdminRules
} from "@openzeppelin/contracts/access/extensions/AccessControlDefaultAdminRules.sol";
import {TimelockController} from "@openzeppelin/contracts/governance/TimelockController.sol";
import {IDecidedByMembers} from "../interfaces/IOrganization.sol";

/// @title The administrator of an organization that waits: what was decided by votes, or proposed by the one key that
/// may, happens after a delay, which everybody can see running.
/// @notice Only its proposers schedule and cancel: in the end the governor alone, or that key. Anybody executes. Nobody
/// administers it but itself.
contract OrganizationTimelock is TimelockController, IDecidedByMembers {
    /// @inheritdoc IDecidedByMembers
    bool public immutable decidedByMembers;

    /// @param delay s
    /// @param proposers the governor, and at first whoever sets the organization up without a delay. In its last act
    /// that one sets the delay, and gives up its roles unless it is the key that continues to propose.
    /// @param decidedByMembers_ whether the governor proposes, so that the organization keeps MIN_VOTERS members
    constructor(uint256 delay, address[] memory proposers, bool decidedByMembers_)
        TimelockController(delay, proposers, _anybody(), address(0))
    {
        decidedByMembers = decidedByMembers_;
    }

    /// @notice Take over from an administrator who has named this contract as the next one.
    /// @param organization which is governed from now on
    function acceptAdministration(AccessControlDefaultAdminRules organization) external {
        organization.acceptDefaultAdminTransfer();
    }

    /// @dev IDecidedByMembers only where they do decide.
    function supportsInterface(bytes4 interfaceId) public view override returns (bool) {
        if (interfaceId == type(IDecidedByMembers).interfaceId) return decidedByMembers;
        return super.supportsInterface(interfaceId);
    }

    function _anybody() private pure returns (address[] memory accounts) {
        accounts = new address[](1);
    }
}
