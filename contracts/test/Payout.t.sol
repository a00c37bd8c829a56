// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IProviders} from "../src/interfaces/IProviders.sol";
import {IServiceManager, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {ITaskManager, TaskState, Ruling} from "../src/interfaces/ITaskManager.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {MEMBER_ROLE} from "../src/types/Roles.sol";
import {Fixture} from "./Fixture.sol";
import {Instances} from "./Instances.sol";
import {WeirdToken} from "./Tokens.t.sol";

/// @notice robot1 has named `safe`. Its key may be anybody's from then on.
contract PayoutTest is Fixture {
    address private immutable safe = makeAddr("safe");
    address private immutable thief = makeAddr("thief");
    uint256 private _robots;

    function setUp() public override {
        super.setUp();
        _name(robot1, robot1, safe);
        _robots = coin.balanceOf(robot1);
    }

    // -- who is paid ----------------------------------------------------------------------------------------

    function test_whoNamesNobodyIsPaidItself() public {
        assertEq(providers.payoutOf(robot2), robot2);
        offer(robot2, 80 ether);
        attempt(post(alice, 100 ether), true);
        assertEq(coin.balanceOf(robot2), 80 ether);
    }

    function test_anAcceptedProofPaysThePayoutAddress() public {
        assertEq(providers.payoutOf(robot1), safe);
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskSettled(taskId, safe, 80 ether, 20 ether);
        judge(taskId, true);
        _assertPaid(80 ether);
        assertEq(coin.balanceOf(alice), 1920 ether, "the surplus is the creator's");
    }

    function test_soDoImpossibleAndTheAuditorsAndSilencePaysNobody() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        vm.warp(block.timestamp + WINDOW + AUDIT_WINDOW + 1);
        tasks.conclude(taskId);
        _assertPaid(0);

        taskId = post(alice, 100 ether);
        submit(taskId);
        judgeAs(oracle, taskId, Ruling.Impossible, 0);
        _assertPaid(8 ether);

        taskId = post(alice, 100 ether);
        submit(taskId);
        judgeAs(oracle, taskId, Ruling.None, 0);
        judgeAs(auditor, taskId, Ruling.Accepted, 50 ether);
        _assertPaid(58 ether);
    }

    function test_whatChangesAtWorkHoldsForThisWork() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        _name(safe, robot1, bob);
        judge(taskId, true);
        assertEq(coin.balanceOf(bob), 2080 ether);
        _assertPaid(0);
    }

    function test_aCreatorsRefundIsItsOwn() public {
        TaskId taskId = post(robot1, 100 ether);
        vm.prank(robot1);
        tasks.cancelTask(taskId);
        _assertPaid(0);
        assertEq(coin.balanceOf(robot1), _robots);
    }

    // -- who may change it ----------------------------------------------------------------------------------

    function test_onlyThePayoutAddressNamesTheNext() public {
        vm.expectEmit(address(providers));
        emit IProviders.PayoutChanged(robot1, bob);
        _name(safe, robot1, bob);
        assertEq(providers.payoutOf(robot1), bob);
        vm.expectRevert(abi.encodeWithSelector(IProviders.NotPayout.selector, robot1, safe, bob));
        _name(safe, robot1, safe);
    }

    function test_itGivesTheChoiceBack() public {
        _name(safe, robot1, robot1);
        assertEq(providers.payoutOf(robot1), robot1);
        _name(robot1, robot1, bob);
        assertEq(providers.payoutOf(robot1), bob);
    }

    function test_somebodyHasToBePaid() public {
        vm.expectRevert(abi.encodeWithSelector(IProviders.NoPayout.selector, robot1));
        _name(safe, robot1, address(0));
    }

    function test_whoIsNoMemberOrSuspendedOrAsleepIsStillPaidWhereItSays() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.startPrank(admin);
        organization.setMembersOnly(true);
        organization.suspendProvider(robot1);
        vm.stopPrank();
        _name(safe, robot1, bob);
        attempt(taskId, true);
        assertEq(coin.balanceOf(bob), 2080 ether);
    }

    // -- bonds ----------------------------------------------------------------------------------------------

    function test_theBondOfARetiredServiceGoesThere() public {
        ServiceId serviceId = _bonded();
        update(serviceId, 80 ether, ServiceState.Retired);
        assertEq(coin.balanceOf(safe), 50 ether);
    }

    function test_soDoesTheBondOfOneThatRetiresAtWork() public {
        ServiceId serviceId = _bonded();
        TaskId taskId = post(alice, 100 ether);
        update(serviceId, 80 ether, ServiceState.Retired);
        attempt(taskId, true);
        assertEq(coin.balanceOf(safe), 130 ether);
    }

    function test_aBondThatFailuresLeftGoesThere() public {
        ServiceId serviceId = _bonded();
        TaskId taskId = post(alice, 100 ether);
        update(serviceId, 80 ether, ServiceState.Retired);
        attempt(taskId, false);
        assertEq(coin.balanceOf(safe), 30 ether);
        assertEq(coin.balanceOf(address(organization)), 2020 ether);
    }

    function test_whoLostTheKeyRetiresItsServices() public {
        ServiceId serviceId = _bonded();
        vm.startPrank(safe);
        bytes memory refusal =
            abi.encodeWithSelector(IServiceManager.NotProvider.selector, serviceId, safe, robot1);
        vm.expectRevert(refusal);
        services.updateService(serviceId, 1 ether, ServiceState.Active);
        vm.expectRevert(refusal);
        services.updateService(serviceId, 80 ether, ServiceState.Paused);
        services.updateService(serviceId, 80 ether, ServiceState.Retired);
        vm.stopPrank();
        assertEq(coin.balanceOf(safe), 50 ether);
    }

    function test_nobodyElseRetiresThem() public {
        ServiceId serviceId = _bonded();
        vm.expectRevert(
            abi.encodeWithSelector(IServiceManager.NotProvider.selector, serviceId, stranger, robot1)
        );
        vm.prank(stranger);
        services.updateService(serviceId, 80 ether, ServiceState.Retired);
    }

    // -- attacks: a thief has the robot's key ----------------------------------------------------------------

    function test_attack_theThiefNamesItself() public {
        vm.expectRevert(abi.encodeWithSelector(IProviders.NotPayout.selector, robot1, robot1, safe));
        _name(robot1, robot1, thief);
        vm.expectRevert(abi.encodeWithSelector(IProviders.NotPayout.selector, robot1, thief, safe));
        _name(thief, robot1, thief);
        vm.expectRevert(abi.encodeWithSelector(IProviders.NotPayout.selector, robot1, robot1, safe));
        _name(robot1, robot1, robot1);
    }

    function test_attack_theThiefRetiresAndRegistersAnew() public {
        ServiceId serviceId = _bonded();
        update(serviceId, 80 ether, ServiceState.Retired);
        setTerms(0, 0, 0);
        offer(robot1, 80 ether);
        attempt(post(alice, 100 ether), true);
        assertEq(coin.balanceOf(safe), 130 ether);
        assertEq(coin.balanceOf(robot1), _robots - 50 ether);
    }

    function test_attack_theThiefIsDismissedAndAdmittedAgain() public {
        vm.startPrank(admin);
        organization.setMembersOnly(true);
        organization.grantRole(MEMBER_ROLE, alice);
        organization.grantRole(MEMBER_ROLE, robot1);
        organization.revokeRole(MEMBER_ROLE, robot1);
        organization.grantRole(MEMBER_ROLE, robot1);
        vm.stopPrank();
        offer(robot1, 80 ether);
        attempt(post(alice, 100 ether), true);
        _assertPaid(80 ether);
    }

    function test_attack_aStrangerNamesForOthers() public {
        vm.expectRevert(abi.encodeWithSelector(IProviders.NotPayout.selector, robot2, stranger, robot2));
        _name(stranger, robot2, stranger);
        vm.expectRevert(
            abi.encodeWithSelector(
                IProviders.NotPayout.selector, address(organization), stranger, address(organization)
            )
        );
        _name(stranger, address(organization), stranger);
    }

    /// @dev Nobody is asked whom others name: to be named gives no right over the account but the named one.
    function test_attack_whoIsNamedDoesNotSpeakForTheProvider() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotExecutor.selector, taskId, safe, robot1));
        vm.prank(safe);
        tasks.submitProof(taskId, 1, PROOF, URI);
        taskId = post(robot1, 100 ether);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotCreator.selector, taskId, safe, robot1));
        vm.prank(safe);
        tasks.cancelTask(taskId);
    }

    /// @dev An executor that names its judge has given its earnings away, but holds up no verdict.
    function test_attack_anExecutorNamesItsJudge() public {
        _name(safe, robot1, oracle);
        offer(robot1, 80 ether);
        attempt(post(alice, 100 ether), true);
        assertEq(coin.balanceOf(oracle), 80 ether);
        TaskId taskId = post(alice, 100 ether);
        attempt(taskId, false);
        assertAssigned(taskId, serviceNo(1));
    }

    function test_attack_aCreatorPaysItselfForARobotsName() public {
        _name(safe, robot1, alice);
        ServiceId serviceId = offer(robot1, 500 ether);
        attempt(post(alice, 500 ether), true);
        assertEq(coin.balanceOf(alice), 2000 ether);
        assertEq(services.service(serviceId).reputation, 32, "its own money came back");
        attempt(post(bob, 500 ether), true);
        assertGt(services.service(serviceId).reputation, 32);
    }

    function test_attack_anOwnerPaysItselfThroughItsDevice() public {
        _name(safe, robot1, alice);
        vm.prank(address(organization));
        providers.recordOwner(bob, alice);
        ServiceId serviceId = offer(robot1, 500 ether);
        attempt(post(bob, 500 ether), true);
        assertEq(services.service(serviceId).reputation, 32);
    }

    // -- a token that refuses --------------------------------------------------------------------------------

    function test_whatATokenRefusedWaitsForThePayoutAddress() public {
        WeirdToken token = _weird();
        token.behave(WeirdToken.Way.Reverts, safe);
        offer(robot1, 80 ether);
        attempt(post(alice, 100 ether), true);
        assertEq(tasks.pendingPayments(safe), 80 ether);
        assertEq(tasks.pendingPayments(robot1), 0);
        // It is always refused: it names another one for itself.
        _name(safe, safe, bob);
        tasks.withdrawPayments(safe);
        assertEq(token.balanceOf(bob), 80 ether);
    }

    function test_attack_theThiefCollectsWhatWasOwedBefore() public {
        WeirdToken token = _weird();
        _name(safe, robot1, robot1);
        token.behave(WeirdToken.Way.Reverts, robot1);
        offer(robot1, 80 ether);
        attempt(post(alice, 100 ether), true);
        token.behave(WeirdToken.Way.Well, address(0));
        _name(robot1, robot1, safe);
        vm.prank(robot1);
        tasks.withdrawPayments(robot1);
        assertEq(token.balanceOf(safe), 80 ether);
        assertEq(token.balanceOf(robot1), 0);
    }

    function _weird() private returns (WeirdToken token) {
        token = new WeirdToken();
        found(token);
        token.mint(alice, 1000 ether);
        vm.prank(alice);
        token.approve(address(tasks), type(uint256).max);
        _name(robot1, robot1, safe);
    }

    function _bonded() private returns (ServiceId serviceId) {
        setTerms(50 ether, 20 ether, 0);
        return offer(robot1, 80 ether);
    }

    function _name(address caller, address provider, address payout) private {
        vm.prank(caller);
        providers.setPayout(provider, payout);
    }

    function _assertPaid(uint256 amount) private view {
        assertEq(coin.balanceOf(safe), amount, "the payout address");
        assertEq(coin.balanceOf(robot1), _robots, "the robot");
        assertEq(coin.balanceOf(thief), 0);
    }
}

/// @notice Stakes of challenges.
contract PayoutOfStakesTest is Instances {
    address private immutable safe = makeAddr("safe");

    function setUp() public override {
        super.setUp();
        vm.prank(robot1);
        providers.setPayout(robot1, safe);
    }

    function test_aStakeAndWhatItWinsGoToThePayoutAddress() public {
        TaskId taskId = ruled(Ruling.Rejected);
        uint256 robots = coin.balanceOf(robot1);
        challenge(robot1, taskId);
        decideSecond(taskId, Ruling.Accepted);
        challenge(alice, taskId);
        decideThird(taskId, Ruling.Accepted);
        assertState(taskId, TaskState.Settled);
        disputes.settle(taskId, 1);
        assertEq(coin.balanceOf(safe), 80 ether + STAKE + APPEAL, "price, stake and the stake of alice");
        assertEq(coin.balanceOf(robot1), robots - STAKE);
        assertEq(coin.balanceOf(address(disputes)), 0);
    }

    function test_aStakeThatGoesBackGoesThere() public {
        TaskId taskId = ruled(Ruling.Rejected);
        challenge(robot1, taskId);
        skip(DECISION + 1);
        disputes.settle(taskId, 1);
        assertEq(coin.balanceOf(safe), STAKE);
        assertEq(coin.balanceOf(address(disputes)), 0);
    }
}
