// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Votes} from "@openzeppelin/contracts/governance/utils/Votes.sol";
import {EIP712} from "@openzeppelin/contracts/utils/cryptography/EIP712.sol";
import {Time} from "@openzeppelin/contracts/utils/types/Time.sol";
import {IOrganization} from "../interfaces/IOrganization.sol";

/// @title One vote for each member of an organization, whatever it owns.
/// @notice Votes are neither transferred nor delegated. Who gets k accounts admitted has k votes of n, and each was
/// admitted by the administrator: by a majority of those who were there before, where that is a governor.
contract MemberVotes is Votes {
    IOrganization public immutable organization;
    mapping(address account => bool) private _counted;

    error NotDelegable(address account);

    constructor(IOrganization organization_) EIP712("RODEO member votes", "1") {
        organization = organization_;
    }

    /// @notice Give `account` its vote from now on if it is a member, and take it back if it is none any more. Anybody
    /// may say so, because the organization is asked.
    function sync(address account) external {
        bool member = organization.isMember(account);
        if (member == _counted[account]) return;
        if (member && delegates(account) == address(0)) _delegate(account, account);
        _counted[account] = member;
        if (member) _transferVotingUnits(address(0), account, 1);
        else _transferVotingUnits(account, address(0), 1);
    }

    /// @notice Whoever is dismissed does not vote any more, in running votes either.
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
