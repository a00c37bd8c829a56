// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {IGovernor} from "@openzeppelin/contracts/governance/IGovernor.sol";
import {TimelockController} from "@openzeppelin/contracts/governance/TimelockController.sol";
import {MemberVotes} from "../src/governance/MemberVotes.sol";
import {OrganizationGovernor} from "../src/governance/OrganizationGovernor.sol";
import {OrganizationTimelock} from "../src/governance/OrganizationTimelock.sol";
import {Instance} from "../src/interfaces/IDisputeJudge.sol";
import {IJudge} from "../src/interfaces/IJudge.sol";
import {IOrganization} from "../src/interfaces/IOrganization.sol";
import {Terms} from "../src/interfaces/IProviders.sol";
import {ServiceState} from "../src/interfaces/IServiceManager.sol";
import {CommitteeJudge} from "../src/judges/CommitteeJudge.sol";
import {DisputeJudge} from "../src/judges/DisputeJudge.sol";
import {RoleJudge} from "../src/judges/RoleJudge.sol";
import {KindId} from "../src/types/KindId.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {MEMBER_ROLE, OPERATOR_ROLE, ORACLE_ROLE, TREASURER_ROLE} from "../src/types/Roles.sol";
import {Fixture} from "./Fixture.sol";

abstract contract Timelocks is Fixture {
    function timelockOf(uint256 delay, address[] memory proposers, bool byMembers)
        internal
        returns (OrganizationTimelock)
    {
        return OrganizationTimelock(
            payable(deployed("OrganizationTimelock", abi.encode(delay, proposers, byMembers)))
        );
    }
}

/// @notice An organization whose members decide by votes, with a timelock as its administrator.
contract GovernanceTest is Timelocks {
    uint256 private constant DELAY = 2 days;
    uint32 private constant VOTING_PERIOD = 3 days;
    uint8 private constant AGAINST = 0;
    uint8 private constant FOR = 1;

    MemberVotes private votes;
    OrganizationTimelock private timelock;
    OrganizationGovernor private governor;
    ServiceId private serviceId;

    // What the tests propose.
    address[] private targets = new address[](1);
    uint256[] private values = new uint256[](1);
    bytes[] private calldatas = new bytes[](1);
    string private description = "a higher price";

    function setUp() public override {
        super.setUp();
        votes = MemberVotes(deployed("MemberVotes", abi.encode(organization)));
        uint64 nonce = vm.getNonce(address(this));
        address[] memory proposers = new address[](1);
        proposers[0] = vm.computeCreateAddress(address(this), nonce + 1);
        timelock = timelockOf(DELAY, proposers, true);
        governor = _governor();
        vm.startPrank(admin);
        serviceId = organization.registerService(CLEANING, 80 ether, NO_LIMIT, true, "");
        organization.grantRole(MEMBER_ROLE, alice);
        organization.grantRole(MEMBER_ROLE, bob);
        organization.grantRole(MEMBER_ROLE, robot1);
        // So that proposals set the prices of the organization's services.
        organization.grantRole(OPERATOR_ROLE, address(timelock));
        organization.beginDefaultAdminTransfer(address(timelock));
        vm.stopPrank();
        address[3] memory members = [alice, bob, robot1];
        for (uint256 i = 0; i < members.length; ++i) {
            votes.sync(members[i]);
        }
        vm.warp(block.timestamp + 1);
        timelock.acceptAdministration(organization);
        (targets[0], calldatas[0]) =
        (
            address(organization),
            abi.encodeCall(organization.updateService, (serviceId, 90 ether, ServiceState.Active))
        );
        vm.warp(block.timestamp + 1);
    }

    function _governor() private returns (OrganizationGovernor) {
        bytes memory arguments = abi.encode(votes, timelock, VOTING_PERIOD, 25);
        return OrganizationGovernor(payable(deployed("OrganizationGovernor", arguments)));
    }

    function _propose(address who) private returns (uint256 proposalId) {
        vm.prank(who);
        proposalId = governor.propose(targets, values, calldatas, description);
        vm.warp(block.timestamp + 1);
    }

    function _vote(address who, uint256 proposalId, uint8 support) private {
        vm.prank(who);
        governor.castVote(proposalId, support);
    }

    function _endVote(uint256 proposalId) private {
        vm.warp(governor.proposalDeadline(proposalId) + 1);
    }

    function _queue() private {
        governor.queue(targets, values, calldatas, keccak256(bytes(description)));
    }

    function _execute() private {
        governor.execute(targets, values, calldatas, keccak256(bytes(description)));
    }

    function _assertState(uint256 proposalId, IGovernor.ProposalState expected) private view {
        assertEq(uint8(governor.state(proposalId)), uint8(expected));
    }

    /// @dev Alice proposes it, everybody agrees, and the delay passes.
    function _decide(bytes memory call) private {
        calldatas[0] = call;
        uint256 proposalId = _propose(alice);
        _vote(alice, proposalId, FOR);
        _vote(bob, proposalId, FOR);
        _vote(robot1, proposalId, FOR);
        _endVote(proposalId);
        _queue();
        vm.warp(block.timestamp + DELAY);
        _execute();
    }

    function test_aVoteChangesAPriceAfterTheDelay() public {
        uint256 proposalId = _propose(alice);
        _vote(alice, proposalId, FOR);
        _vote(bob, proposalId, FOR);
        _vote(robot1, proposalId, AGAINST);
        _endVote(proposalId);
        _queue();
        uint256 ready = block.timestamp + DELAY;
        vm.warp(ready - 1);
        vm.expectPartialRevert(TimelockController.TimelockUnexpectedOperationState.selector);
        _execute();
        assertEq(services.service(serviceId).price, 80 ether);
        vm.warp(ready);
        vm.prank(stranger);
        _execute();
        assertEq(services.service(serviceId).price, 90 ether);
    }

    function test_proposalsSetTermsBudgetsJudgesAndMembers() public {
        _decide(abi.encodeCall(organization.setTerms, (Terms(10 ether, 5 ether, 3))));
        assertEq(organization.terms().bond, 10 ether);
        bytes32 treasurers = TREASURER_ROLE;
        _decide(abi.encodeCall(organization.setBudget, (treasurers, 100 ether, 1 days)));
        assertEq(organization.budgetOf(treasurers).amount, 100 ether);
        bytes32 oracles = ORACLE_ROLE;
        _decide(abi.encodeCall(organization.grantRole, (oracles, robot3)));
        assertTrue(organization.hasRole(oracles, robot3));
        _decide(abi.encodeCall(organization.grantRole, (MEMBER_ROLE, robot2)));
        assertTrue(organization.isMember(robot2));
    }

    function test_nobodyDecidesPastTheTimelock() public {
        bytes32 role = organization.DEFAULT_ADMIN_ROLE();
        address[3] memory others = [admin, alice, address(governor)];
        for (uint256 i = 0; i < others.length; ++i) {
            vm.expectRevert(
                abi.encodeWithSelector(
                    IAccessControl.AccessControlUnauthorizedAccount.selector, others[i], role
                )
            );
            vm.prank(others[i]);
            organization.setMembersOnly(true);
        }
        bytes32 proposer = timelock.PROPOSER_ROLE();
        vm.expectRevert(
            abi.encodeWithSelector(IAccessControl.AccessControlUnauthorizedAccount.selector, admin, proposer)
        );
        vm.prank(admin);
        timelock.schedule(address(organization), 0, calldatas[0], 0, 0, DELAY);
    }

    function test_aMinorityDecidesNothing() public {
        uint256 proposalId = _propose(alice);
        _vote(alice, proposalId, FOR);
        _vote(bob, proposalId, AGAINST);
        _vote(robot1, proposalId, AGAINST);
        _endVote(proposalId);
        _assertState(proposalId, IGovernor.ProposalState.Defeated);
        vm.expectPartialRevert(IGovernor.GovernorUnexpectedProposalState.selector);
        _queue();
    }

    function test_withoutAQuorumNothingIsDecided() public {
        uint256 proposalId = _propose(alice);
        _endVote(proposalId);
        _assertState(proposalId, IGovernor.ProposalState.Defeated);
    }

    function test_whoIsNoMemberNeitherProposesNorCounts() public {
        vm.expectRevert(
            abi.encodeWithSelector(IGovernor.GovernorInsufficientProposerVotes.selector, stranger, 0, 1)
        );
        _propose(stranger);
        uint256 proposalId = _propose(alice);
        _vote(stranger, proposalId, FOR);
        (, uint256 inFavour,) = governor.proposalVotes(proposalId);
        assertEq(inFavour, 0);
    }

    /// @notice The Sybil bound: k accounts that the members admit have k votes, and none in what was proposed before;
    /// accounts that nobody admitted have none, however much they own and however many they are.
    function test_anIdentityHasOneVoteAndOnlyOnceItIsAdmitted() public {
        for (uint160 i = 1; i <= 20; ++i) {
            address sybil = address(i << 96);
            vm.prank(alice);
            coin.transfer(sybil, 1 ether);
            votes.sync(sybil);
            assertEq(votes.getVotes(sybil), 0);
        }
        calldatas[0] = abi.encodeCall(organization.grantRole, (MEMBER_ROLE, robot2));
        uint256 first = _propose(alice);
        _vote(alice, first, FOR);
        _vote(bob, first, FOR);
        _endVote(first);
        _queue();
        description = "proposed before the admission";
        uint256 before = _propose(alice);
        vm.warp(block.timestamp + DELAY);
        description = "a higher price";
        _execute();
        votes.sync(robot2);
        votes.sync(robot2);
        vm.warp(block.timestamp + 1);
        assertEq(votes.getVotes(robot2), 1);
        assertEq(votes.getPastTotalSupply(block.timestamp - 1), 4);
        _vote(robot2, before, FOR);
        (, uint256 inFavour,) = governor.proposalVotes(before);
        assertEq(inFavour, 0);
        description = "proposed after it";
        uint256 afterwards = _propose(robot2);
        _vote(robot2, afterwards, FOR);
        (, inFavour,) = governor.proposalVotes(afterwards);
        assertEq(inFavour, 1);
    }

    function test_votesAreNotDelegated() public {
        vm.startPrank(alice);
        vm.expectRevert(abi.encodeWithSelector(MemberVotes.NotDelegable.selector, alice));
        votes.delegate(bob);
        vm.expectRevert(abi.encodeWithSelector(MemberVotes.NotDelegable.selector, alice));
        votes.delegateBySig(bob, 0, type(uint256).max, 0, 0, 0);
    }

    function _member(uint160 number) private returns (address account) {
        account = address(number << 96);
        vm.prank(address(timelock));
        organization.grantRole(MEMBER_ROLE, account);
        votes.sync(account);
    }

    function test_aQuorumIsRoundedUpIsTwoAndIsAMajorityOfFewerThanTen() public {
        // 25 % of 3 to 13 members.
        uint8[11] memory expected = [2, 3, 3, 4, 4, 5, 5, 3, 3, 3, 4];
        for (uint160 i = 0; i < expected.length; ++i) {
            assertEq(votes.getPastTotalSupply(block.timestamp - 1), 3 + i);
            assertEq(governor.quorum(block.timestamp - 1), expected[i], "quorum");
            _member(i + 1);
            vm.warp(block.timestamp + 1);
        }
    }

    function test_noPercentageLetsOneMemberDecide() public {
        targets[0] = address(governor);
        _decide(abi.encodeCall(governor.updateQuorumNumerator, (0)));
        for (uint160 i = 1; i <= 9; ++i) {
            _member(i);
        }
        vm.warp(block.timestamp + 1);
        assertEq(governor.quorum(block.timestamp - 1), 2);
    }

    function test_attack_oneOfSevenTakesTheTreasury() public {
        for (uint160 i = 1; i <= 4; ++i) {
            _member(i);
        }
        vm.warp(block.timestamp + 1);
        bytes32 treasurers = TREASURER_ROLE;
        calldatas[0] = abi.encodeCall(organization.grantRole, (treasurers, alice));
        uint256 proposalId = _propose(alice);
        _vote(alice, proposalId, FOR);
        _vote(bob, proposalId, FOR);
        _vote(robot1, proposalId, FOR);
        _endVote(proposalId);
        _assertState(proposalId, IGovernor.ProposalState.Defeated);
    }

    function _expectNotCounted(uint256 counted) private {
        vm.expectRevert(abi.encodeWithSelector(OrganizationGovernor.MembersNotCounted.selector, counted, 30));
    }

    /// @dev Thirty are admitted, of whom somebody has told the votes of three only.
    function test_attack_aQuorumOfTheFewWhomTheVotesKnow() public {
        vm.startPrank(address(timelock));
        for (uint160 i = 1; i <= 27; ++i) {
            organization.grantRole(MEMBER_ROLE, address(i << 96));
        }
        vm.stopPrank();
        _expectNotCounted(3);
        _propose(alice);
        vm.startPrank(stranger);
        for (uint160 i = 1; i <= 27; ++i) {
            votes.sync(address(i << 96));
        }
        vm.stopPrank();
        // Told in this second, they count from the next on.
        _expectNotCounted(3);
        _propose(alice);
        vm.warp(block.timestamp + 1);
        uint256 proposalId = _propose(alice);
        assertEq(governor.quorum(governor.proposalSnapshot(proposalId)), 8);
    }

    /// @dev Whoever was dismissed counts for the quorum until the votes are told, which makes it no smaller.
    function test_whoIsDismissedHoldsUpNoProposal() public {
        _member(1);
        vm.warp(block.timestamp + 1);
        vm.prank(address(timelock));
        organization.revokeRole(MEMBER_ROLE, bob);
        _propose(alice);
    }

    function _expectTooFew(uint256 members) private {
        vm.expectRevert(abi.encodeWithSelector(IOrganization.TooFewMembers.selector, members, 3));
    }

    function test_nobodyLeavesBelowThreeWhileMembersVote() public {
        bytes32 role = MEMBER_ROLE;
        _expectTooFew(2);
        vm.prank(bob);
        organization.renounceRole(role, bob);
        vm.startPrank(address(timelock));
        _expectTooFew(2);
        organization.revokeRole(MEMBER_ROLE, bob);
        _expectTooFew(2);
        organization.revokeRole(role, bob);
        bytes[] memory both = new bytes[](2);
        both[0] = abi.encodeCall(organization.revokeRole, (MEMBER_ROLE, bob));
        both[1] = abi.encodeCall(organization.grantRole, (MEMBER_ROLE, robot2));
        _expectTooFew(2);
        organization.multicall(both);
        (both[0], both[1]) = (both[1], both[0]);
        organization.multicall(both);
        // Who is no member any more, or is one already, changes no number.
        organization.revokeRole(MEMBER_ROLE, bob);
        organization.grantRole(MEMBER_ROLE, alice);
        assertEq(organization.memberCount(), 3);
        organization.beginDefaultAdminTransfer(admin);
        vm.stopPrank();
        // Where a key decides, there may be fewer.
        vm.warp(block.timestamp + 1);
        vm.startPrank(admin);
        organization.acceptDefaultAdminTransfer();
        organization.revokeRole(MEMBER_ROLE, robot2);
        vm.stopPrank();
        assertEq(organization.memberCount(), 2);
    }

    function test_votesAreNotSwitchedOnBelowThree() public {
        found(coin);
        vm.startPrank(admin);
        organization.grantRole(MEMBER_ROLE, alice);
        organization.grantRole(MEMBER_ROLE, bob);
        organization.beginDefaultAdminTransfer(address(timelock));
        vm.stopPrank();
        vm.warp(block.timestamp + 1);
        _expectTooFew(2);
        timelock.acceptAdministration(organization);
        vm.prank(admin);
        organization.grantRole(MEMBER_ROLE, robot1);
        timelock.acceptAdministration(organization);
        assertEq(organization.defaultAdmin(), address(timelock));
    }

    /// @dev The timelock administers it from the constructor on, and the founder has forgotten somebody.
    function test_whereThereAreFewerThanThreeNobodyProposes() public {
        found(coin);
        votes = MemberVotes(deployed("MemberVotes", abi.encode(organization)));
        governor = _governor();
        vm.startPrank(admin);
        organization.grantRole(MEMBER_ROLE, alice);
        organization.grantRole(MEMBER_ROLE, bob);
        vm.stopPrank();
        votes.sync(alice);
        votes.sync(bob);
        vm.warp(block.timestamp + 1);
        _expectTooFew(2);
        _propose(alice);
        vm.prank(admin);
        organization.grantRole(MEMBER_ROLE, robot1);
        votes.sync(robot1);
        vm.warp(block.timestamp + 1);
        _propose(alice);
    }

    function test_whoIsDismissedDoesNotVoteAnyMore() public {
        _member(1);
        vm.warp(block.timestamp + 1);
        _decide(abi.encodeCall(organization.revokeRole, (MEMBER_ROLE, bob)));
        description = "without bob";
        uint256 proposalId = _propose(alice);
        // Also before anybody has told the votes.
        _vote(bob, proposalId, FOR);
        (, uint256 inFavour,) = governor.proposalVotes(proposalId);
        assertEq(inFavour, 0);
        votes.sync(bob);
        vm.warp(block.timestamp + 1);
        assertEq(votes.getPastTotalSupply(block.timestamp - 1), 3);
        assertEq(votes.getVotes(bob), 0);
    }

    function test_theTimelockAcceptsOnlyWhatItIsOffered() public {
        found(coin);
        vm.expectPartialRevert(bytes4(keccak256("AccessControlInvalidDefaultAdmin(address)")));
        timelock.acceptAdministration(organization);
    }

    function test_whoSetsUpActsAtOnceAndEndsWithNothing() public {
        address[] memory proposers = new address[](2);
        (proposers[0], proposers[1]) = (address(governor), address(this));
        OrganizationTimelock young = timelockOf(0, proposers, true);
        bytes32 proposer = young.PROPOSER_ROLE();
        address[] memory itself = new address[](3);
        (itself[0], itself[1], itself[2]) = (address(young), address(young), address(young));
        bytes[] memory last = new bytes[](3);
        last[0] = abi.encodeCall(young.updateDelay, (DELAY));
        last[1] = abi.encodeCall(young.revokeRole, (proposer, address(this)));
        last[2] = abi.encodeCall(young.revokeRole, (young.CANCELLER_ROLE(), address(this)));
        young.scheduleBatch(itself, new uint256[](3), last, 0, 0, 0);
        young.executeBatch(itself, new uint256[](3), last, 0, 0);
        assertEq(young.getMinDelay(), DELAY);
        assertTrue(young.hasRole(proposer, address(governor)));
        assertFalse(young.hasRole(young.CANCELLER_ROLE(), address(this)));
        assertFalse(young.hasRole(young.DEFAULT_ADMIN_ROLE(), address(this)));
        vm.expectRevert(
            abi.encodeWithSelector(
                IAccessControl.AccessControlUnauthorizedAccount.selector, address(this), proposer
            )
        );
        young.schedule(address(organization), 0, calldatas[0], 0, 0, DELAY);
    }
}

/// @notice An organization whose administrator proposes and waits: a timelock, to which the key of `admin` speaks.
contract WaitingAdministratorTest is Timelocks {
    uint256 private constant DELAY = 2 days;

    OrganizationTimelock private timelock;

    // What the tests propose.
    address[] private targets = new address[](1);
    uint256[] private values = new uint256[](1);
    bytes[] private calls = new bytes[](1);

    function setUp() public override {
        super.setUp();
        address[] memory proposers = new address[](1);
        proposers[0] = admin;
        timelock = timelockOf(0, proposers, false);
        vm.prank(admin);
        organization.beginDefaultAdminTransfer(address(timelock));
        vm.warp(block.timestamp + 1);
        timelock.acceptAdministration(organization);
        // The founder's last act, which is done at once.
        _propose(address(timelock), abi.encodeCall(timelock.updateDelay, (DELAY)), 0, 0);
        _execute(0);
        assertEq(timelock.getMinDelay(), DELAY);
        (targets[0], calls[0]) = (address(organization), abi.encodeCall(organization.setMembersOnly, (true)));
    }

    function _propose(address target, bytes memory call, bytes32 salt, uint256 delay) private {
        (targets[0], calls[0]) = (target, call);
        vm.prank(admin);
        timelock.scheduleBatch(targets, values, calls, 0, salt, delay);
    }

    function _proposeMembersOnly(bytes32 salt) private {
        _propose(address(organization), abi.encodeCall(organization.setMembersOnly, (true)), salt, DELAY);
    }

    function _execute(bytes32 salt) private {
        vm.prank(stranger);
        timelock.executeBatch(targets, values, calls, 0, salt);
    }

    function _expectUnauthorized(address account, bytes32 role) private {
        vm.expectRevert(
            abi.encodeWithSelector(IAccessControl.AccessControlUnauthorizedAccount.selector, account, role)
        );
    }

    function test_whatIsProposedIsDoneByAnybodyAfterTheDelayAndNotBefore() public {
        _proposeMembersOnly(0);
        vm.warp(block.timestamp + DELAY - 1);
        vm.expectPartialRevert(TimelockController.TimelockUnexpectedOperationState.selector);
        _execute(0);
        vm.warp(block.timestamp + 1);
        _execute(0);
        assertTrue(organization.membersOnly());
    }

    function test_aBystanderNeitherProposesNorCancels() public {
        (bytes32 proposer, bytes32 canceller) = (timelock.PROPOSER_ROLE(), timelock.CANCELLER_ROLE());
        _expectUnauthorized(stranger, proposer);
        vm.prank(stranger);
        timelock.scheduleBatch(targets, values, calls, 0, 0, DELAY);
        _proposeMembersOnly(0);
        bytes32 id = timelock.hashOperationBatch(targets, values, calls, 0, 0);
        _expectUnauthorized(stranger, canceller);
        vm.prank(stranger);
        timelock.cancel(id);
        assertTrue(timelock.isOperationPending(id));
    }

    function test_theAdministratorsKeyDoesNothingAtOnce() public {
        bytes32 administrator = organization.DEFAULT_ADMIN_ROLE();
        bytes32 treasurer = TREASURER_ROLE;
        bytes32 proposer = timelock.PROPOSER_ROLE();
        vm.startPrank(admin);
        _expectUnauthorized(admin, administrator);
        organization.setMembersOnly(true);
        _expectUnauthorized(admin, administrator);
        organization.grantRole(treasurer, admin);
        _expectUnauthorized(admin, administrator);
        organization.beginDefaultAdminTransfer(admin);
        _expectUnauthorized(admin, administrator);
        timelock.grantRole(proposer, stranger);
        vm.expectRevert(abi.encodeWithSelector(TimelockController.TimelockUnauthorizedCaller.selector, admin));
        timelock.updateDelay(0);
        vm.expectRevert(
            abi.encodeWithSelector(TimelockController.TimelockInsufficientDelay.selector, DELAY - 1, DELAY)
        );
        timelock.scheduleBatch(targets, values, calls, 0, 0, DELAY - 1);
        vm.stopPrank();
        // Not even by a proposal does it become the administrator at once.
        vm.expectPartialRevert(bytes4(keccak256("AccessControlEnforcedDefaultAdminRules()")));
        vm.prank(address(timelock));
        organization.grantRole(administrator, admin);
    }

    /// @dev Another judge, its judges, its instances and the auditors: whoever looks can see them coming.
    function test_aJudgeIsNamedAfterTheDelay() public {
        RoleJudge other = roleJudge(ORACLE_ROLE, address(0));
        CommitteeJudge committee = committeeJudge(address(0));
        DisputeJudge disputes = DisputeJudge(deployed("DisputeJudge", abi.encode(organization, address(0))));
        bytes32 administrator = organization.DEFAULT_ADMIN_ROLE();
        vm.startPrank(admin);
        _expectUnauthorized(admin, administrator);
        organization.allowKind(CLEANING, other, RULES);
        _expectUnauthorized(admin, administrator);
        organization.setAuditors(other);
        bytes memory refusal = abi.encodeWithSelector(IJudge.NotAdministrator.selector, admin);
        vm.expectRevert(refusal);
        committee.seat(admin, admin, 0, 0);
        vm.expectRevert(refusal);
        committee.setQuorum(CLEANING, 1, 1, 0, 1);
        vm.expectRevert(refusal);
        disputes.setInstances(CLEANING, new Instance[](0));
        vm.stopPrank();
        KindId number = cleaning();
        _propose(
            address(organization), abi.encodeCall(organization.allowKind, (CLEANING, other, RULES)), 0, DELAY
        );
        vm.warp(block.timestamp + DELAY - 1);
        vm.expectPartialRevert(TimelockController.TimelockUnexpectedOperationState.selector);
        _execute(0);
        vm.warp(block.timestamp + 1);
        _execute(0);
        assertTrue(cleaning() != number);
        assertEq(address(organization.judgeNumbered(cleaning())), address(other));
    }

    function test_theDelayIsShortenedAfterTheDelayAndShortensNothingThatWaits() public {
        _proposeMembersOnly(0);
        bytes32 waits = timelock.hashOperationBatch(targets, values, calls, 0, 0);
        uint256 ready = timelock.getTimestamp(waits);
        vm.warp(block.timestamp + 1);
        _propose(address(timelock), abi.encodeCall(timelock.updateDelay, (1)), 0, DELAY);
        vm.expectPartialRevert(TimelockController.TimelockUnexpectedOperationState.selector);
        _execute(0);
        assertEq(timelock.getMinDelay(), DELAY);
        vm.warp(block.timestamp + DELAY);
        _execute(0);
        assertEq(timelock.getMinDelay(), 1);
        assertEq(timelock.getTimestamp(waits), ready);
    }

    function test_equalProposalsAreToldApartByTheirSalt() public {
        _proposeMembersOnly(0);
        vm.expectPartialRevert(TimelockController.TimelockUnexpectedOperationState.selector);
        _proposeMembersOnly(0);
        _proposeMembersOnly(bytes32(uint256(1)));
        vm.warp(block.timestamp + DELAY);
        _execute(0);
        _execute(bytes32(uint256(1)));
        vm.expectPartialRevert(TimelockController.TimelockUnexpectedOperationState.selector);
        _execute(0);
    }

    function test_aProposalWhoseCallsRevertStaysPendingAndSaysWhy() public {
        _propose(
            address(organization),
            abi.encodeCall(organization.setTerms, (Terms(1 ether, 2 ether, 3))),
            0,
            DELAY
        );
        bytes32 id = timelock.hashOperationBatch(targets, values, calls, 0, 0);
        vm.warp(block.timestamp + DELAY);
        vm.expectPartialRevert(IOrganization.InvalidTerms.selector);
        _execute(0);
        assertTrue(timelock.isOperationReady(id));
    }

    function test_whatIsCancelledIsNotDone() public {
        _proposeMembersOnly(0);
        bytes32 id = timelock.hashOperationBatch(targets, values, calls, 0, 0);
        vm.warp(block.timestamp + DELAY);
        vm.prank(admin);
        timelock.cancel(id);
        vm.expectPartialRevert(TimelockController.TimelockUnexpectedOperationState.selector);
        _execute(0);
        assertFalse(organization.membersOnly());
    }

    function test_theKeyThatProposesIsReplacedByAProposal() public {
        bytes32 proposer = timelock.PROPOSER_ROLE();
        targets = new address[](2);
        values = new uint256[](2);
        calls = new bytes[](2);
        targets[1] = address(timelock);
        calls[1] = abi.encodeCall(timelock.revokeRole, (proposer, admin));
        _propose(address(timelock), abi.encodeCall(timelock.grantRole, (proposer, alice)), 0, DELAY);
        vm.warp(block.timestamp + DELAY);
        _execute(0);
        assertTrue(timelock.hasRole(proposer, alice));
        _expectUnauthorized(admin, proposer);
        _proposeMembersOnly(bytes32(uint256(1)));
    }

    /// @dev The text of a proposal is a call to the precompile `identity`, which does nothing.
    function test_aTextAmongTheCallsDoesNothing() public {
        targets = new address[](2);
        values = new uint256[](2);
        calls = new bytes[](2);
        (targets[1], calls[1]) = (address(4), "members only, because we are full");
        _proposeMembersOnly(0);
        vm.warp(block.timestamp + DELAY);
        _execute(0);
        assertTrue(organization.membersOnly());
    }
}
