// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Votes} from "@openzeppelin/contracts/governance/utils/Votes.sol";
import {EIP712} from "@openzeppelin/contracts/utils/cryptography/EIP712.sol";
import {Time} from "@openzeppelin/contracts/utils/types/Time.sol";
import {IOrganization} from "../interfaces/IOrganization.sol";

/// @title One vote for each member of an organization.
/// @notice Votes cannot be transferred or delegated. A person with k admitted accounts has k votes. The administrator
/// admits each account; if the administrator is a governor, a majority of the earlier members does.
contract MemberVotes is Votes {
    IOrganization public immutable organization;
    mapping(address account => bool) private _counted;

    error NotDelegable(address account);

    constructor(IOrganization organization_) EIP712("RODEO member votes", "1") {
        organization = organization_;
    }

    /// @notice Read a membership from the organization: a new member gets its vote, a dismissed one loses it. Anybody
    /// may call this.
    /// @param account the account to read
    function sync(address account) external {
        bool member = organization.isMember(account);
        if (member == _counted[account]) return;
        if (member && delegates(account) == address(0)) _delegate(account, account);
        _counted[account] = member;
        if (member) _transferVotingUnits(address(0), account, 1);
        else _transferVotingUnits(account, address(0), 1);
    }

    /// @notice Returns the votes that an account had at a time. A dismissed member has none, in running votes either.
    /// @param account who votes
    /// @param timepoint block time in seconds
    function getPastVotes(address account, uint256 timepoint) public view override returns (uint256) {
        return organization.isMember(account) ? super.getPastVotes(account, timepoint) : 0;
    }

    /// @dev Seconds: the deadline of a vote is a time that people can read, on every chain.
    function clock() public view override returns (uint48) {
        return Time.timestamp();
    }

    // solhint-disable-next-line func-name-mixedcase
    function CLOCK_MODE() public pure override returns (string memory) {
        return "mode=timestamp";
    }

    function delegate(address) public view override {
        revert NotDelegable(msg.sender);
    }

    function delegateBySig(address, uint256, uint256, uint8, bytes32, bytes32) public view override {
        revert NotDelegable(msg.sender);
    }

    function _getVotingUnits(address account) internal view override returns (uint256) {
        return _counted[account] ? 1 : 0;
    }
}
