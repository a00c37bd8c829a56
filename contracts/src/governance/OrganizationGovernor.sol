// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Governor} from "@openzeppelin/contracts/governance/Governor.sol";
import {TimelockController} from "@openzeppelin/contracts/governance/TimelockController.sol";
import {
    GovernorCountingSimple
} from "@openzeppelin/contracts/governance/extensions/GovernorCountingSimple.sol";
import {GovernorSettings} from "@openzeppelin/contracts/governance/extensions/GovernorSettings.sol";
import {
    GovernorTimelockControl
} from "@openzeppelin/contracts/governance/extensions/GovernorTimelockControl.sol";
import {GovernorVotes} from "@openzeppelin/contracts/governance/extensions/GovernorVotes.sol";
import {
    GovernorVotesQuorumFraction
} from "@openzeppelin/contracts/governance/extensions/GovernorVotesQuorumFraction.sol";
import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";
import {IOrganization, MIN_VOTERS} from "../interfaces/IOrganization.sol";
import {MemberVotes} from "./MemberVotes.sol";

/// @title How an organization decides: OpenZeppelin's governor over a timelock, which is the administrator.
/// @notice Each member has one vote, and may propose while there are MIN_VOTERS members, all of them counted. Votes are those at the time of the
/// proposal; more for than against and a quorum decide. What passed is queued in the timelock and executed after its delay,
/// by anybody.
contract OrganizationGovernor is
    GovernorSettings,
    GovernorCountingSimple,
    GovernorVotes,
    GovernorVotesQuorumFraction,
    GovernorTimelockControl
{
    /// @dev No member decides alone.
    uint256 private constant MIN_QUORUM = 2;
    /// @dev A quorum of fewer members is a majority: a percentage of so few would be one or two of them.
    uint256 private constant SMALL_ORGANIZATION = 10;

    IOrganization private immutable _organization;

    /// @notice The votes know fewer members than there are, so a quorum would be of too few. Anybody tells them, by
    /// MemberVotes.sync.
    error MembersNotCounted(uint256 votes, uint256 members);

    /// @param votes counts one vote for each member
    /// @param timelock the organization's administrator, of which this is the only proposer
    /// @param votingPeriod s
    /// @param quorumPercent of all votes, for or abstaining; see `quorum`
    constructor(MemberVotes votes, TimelockController timelock, uint32 votingPeriod, uint256 quorumPercent)
        Governor("RODEO organization")
        GovernorSettings(0, votingPeriod, 1)
        GovernorVotes(votes)
        GovernorVotesQuorumFraction(quorumPercent)
        GovernorTimelockControl(timelock)
    {
        _organization = votes.organization();
    }

    /// @notice Returns how many votes, for or abstaining, a decision needs: the percentage of all votes, rounded up, but never
    /// less than MIN_QUORUM, and a majority of fewer than SMALL_ORGANIZATION members.
    /// @param timepoint block time in seconds
    function quorum(uint256 timepoint)
        public
        view
        override(Governor, GovernorVotesQuorumFraction)
        returns (uint256)
    {
        uint256 all = token().getPastTotalSupply(timepoint);
        uint256 needed = Math.ceilDiv(all * quorumNumerator(timepoint), quorumDenominator());
        if (all < SMALL_ORGANIZATION) needed = Math.max(needed, all / 2 + 1);
        return Math.max(needed, MIN_QUORUM);
    }

    function state(uint256 proposalId)
        public
        view
        override(Governor, GovernorTimelockControl)
        returns (ProposalState)
    {
        return super.state(proposalId);
    }

    function proposalNeedsQueuing(uint256 proposalId)
        public
        view
        override(Governor, GovernorTimelockControl)
        returns (bool)
    {
        return super.proposalNeedsQueuing(proposalId);
    }

    function proposalThreshold() public view override(Governor, GovernorSettings) returns (uint256) {
        return super.proposalThreshold();
    }

    function _propose(
        address[] memory targets,
        uint256[] memory values,
        bytes[] memory calldatas,
        string memory description,
        address proposer
    ) internal override returns (uint256) {
        uint256 members = _organization.memberCount();
        if (members < MIN_VOTERS) revert IOrganization.TooFewMembers(members, MIN_VOTERS);
        uint256 counted = token().getPastTotalSupply(clock() - 1);
        if (counted < members) revert MembersNotCounted(counted, members);
        return super._propose(targets, values, calldatas, description, proposer);
    }

    function _queueOperations(
        uint256 proposalId,
        address[] memory targets,
        uint256[] memory values,
        bytes[] memory calldatas,
        bytes32 descriptionHash
    ) internal override(Governor, GovernorTimelockControl) returns (uint48) {
        return super._queueOperations(proposalId, targets, values, calldatas, descriptionHash);
    }

    function _executeOperations(
        uint256 proposalId,
        address[] memory targets,
        uint256[] memory values,
        bytes[] memory calldatas,
        bytes32 descriptionHash
    ) internal override(Governor, GovernorTimelockControl) {
        super._executeOperations(proposalId, targets, values, calldatas, descriptionHash);
    }

    function _cancel(
        address[] memory targets,
        uint256[] memory values,
        bytes[] memory calldatas,
        bytes32 descriptionHash
    ) internal override(Governor, GovernorTimelockControl) returns (uint256) {
        return super._cancel(targets, values, calldatas, descriptionHash);
    }

    function _executor() internal view override(Governor, GovernorTimelockControl) returns (address) {
        return super._executor();
    }
}
