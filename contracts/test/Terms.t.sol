// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20Errors} from "@openzeppelin/contracts/interfaces/draft-IERC6093.sol";
import {IOrganization} from "../src/interfaces/IOrganization.sol";
import {IProviders, Outcome, Terms} from "../src/interfaces/IProviders.sol";
import {IServiceManager, Service, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {ITaskManager, TaskRequest, TaskState} from "../src/interfaces/ITaskManager.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {MEMBER_ROLE} from "../src/types/Roles.sol";
import {Fixture} from "./Fixture.sol";

/// @notice Bonds, penalties and suspension.
contract TermsTest is Fixture {
    function test_withoutTermsNothingIsLocked() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        assertEq(services.service(serviceId).bond, 0);
        TaskId taskId = post(alice, 100 ether);
        for (uint256 i = 0; i < ATTEMPTS; ++i) {
            attempt(taskId, false);
        }
        assertEq(uint8(services.service(serviceId).state), uint8(ServiceState.Active));
        assertEq(coin.balanceOf(robot1), 2000 ether);
    }

    function test_aServiceLocksTheBondThatTheOrganizationAsksFor() public {
        setTerms(50 ether, 20 ether, 3);
        vm.expectEmit(address(providers));
        emit IProviders.TermsAgreed(serviceNo(1), 50 ether, 20 ether, 3);
        ServiceId serviceId = offer(robot1, 80 ether);
        Service memory s = services.service(serviceId);
        assertEq(s.bond, 50 ether);
        assertEq(s.penalty, 20 ether);
        assertEq(s.maxFailures, 3);
        assertEq(coin.balanceOf(robot1), 1950 ether);
        assertEq(coin.balanceOf(address(tasks)), 50 ether);
    }

    function test_whoCannotPayTheBondOffersNothing() public {
        setTerms(50 ether, 20 ether, 3);
        vm.expectRevert(
            abi.encodeWithSelector(
                IERC20Errors.ERC20InsufficientAllowance.selector, address(tasks), 0, 50 ether
            )
        );
        offer(robot2, 80 ether);
        assertEq(services.serviceCount(), 0);
    }

    function test_aRejectedAttemptCostsAPenaltyThatGoesToTheTreasury() public {
        setTerms(50 ether, 20 ether, 0);
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        vm.expectEmit(address(providers));
        emit IProviders.BondPenalized(serviceId, taskId, 20 ether);
        judge(taskId, false);
        assertEq(services.service(serviceId).bond, 30 ether);
        assertEq(coin.balanceOf(address(organization)), 2020 ether);
        assertEq(coin.balanceOf(address(tasks)), 130 ether);
    }

    function test_anExpiredAttemptCostsAPenalty() public {
        setTerms(50 ether, 20 ether, 0);
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.warp(block.timestamp + WINDOW + 1);
        tasks.expireTask(taskId);
        assertEq(coin.balanceOf(address(organization)), 2020 ether);
    }

    function test_aVerdictThatNeverComesCostsTheExecutorNothing() public {
        setTerms(50 ether, 20 ether, 1);
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        vm.warp(block.timestamp + WINDOW + AUDIT_WINDOW + 1);
        tasks.conclude(taskId);
        Service memory s = services.service(serviceId);
        assertEq(s.bond, 50 ether);
        assertEq(s.failures, 0);
        assertState(taskId, TaskState.Failed);
    }

    function test_failuresInARowSuspendTheService() public {
        setTerms(0, 0, 2);
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        attempt(taskId, false);
        attempt(taskId, true);
        assertEq(services.service(serviceId).failures, 0, "a success forgives");
        taskId = post(alice, 100 ether);
        attempt(taskId, false);
        submit(taskId);
        vm.expectEmit(address(services));
        emit IServiceManager.ServiceSuspended(serviceId);
        judge(taskId, false);
        assertEq(uint8(services.service(serviceId).state), uint8(ServiceState.Suspended));
        assertState(taskId, TaskState.Open);
    }

    function test_aBondThatNoLongerCoversAPenaltySuspends() public {
        setTerms(50 ether, 20 ether, 0);
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        attempt(taskId, false);
        attempt(taskId, false);
        assertEq(uint8(services.service(serviceId).state), uint8(ServiceState.Suspended));
        assertEq(services.service(serviceId).bond, 10 ether);
        vm.expectRevert(
            abi.encodeWithSelector(IProviders.BondExhausted.selector, serviceId, 10 ether, 20 ether)
        );
        vm.prank(admin);
        organization.reinstateService(serviceId);
    }

    function test_aServiceThatIsSuspendedAtWorkFinishesAndAnswersForIt() public {
        setTerms(20 ether, 20 ether, 0);
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.prank(admin);
        organization.suspendService(serviceId);
        attempt(taskId, false);
        assertEq(services.service(serviceId).bond, 0);
        assertEq(coin.balanceOf(address(organization)), 2020 ether);
    }

    function test_aSuspendedServiceCanOnlyRetire() public {
        setTerms(50 ether, 20 ether, 1);
        ServiceId serviceId = offer(robot1, 80 ether);
        attempt(post(alice, 100 ether), false);
        bytes memory refusal = abi.encodeWithSelector(IServiceManager.ServiceIsSuspended.selector, serviceId);
        vm.startPrank(robot1);
        vm.expectRevert(refusal);
        services.updateService(serviceId, 80 ether, ServiceState.Active);
        vm.expectRevert(refusal);
        services.updateService(serviceId, 80 ether, ServiceState.Paused);
        vm.expectEmit(address(providers));
        emit IProviders.BondReturned(serviceId, robot1, 30 ether);
        services.updateService(serviceId, 80 ether, ServiceState.Retired);
        assertEq(coin.balanceOf(robot1), 1980 ether);
    }

    function test_retiringWhenIdleReturnsTheBondAtOnce() public {
        setTerms(50 ether, 20 ether, 0);
        ServiceId serviceId = offer(robot1, 80 ether);
        update(serviceId, 80 ether, ServiceState.Paused);
        assertEq(coin.balanceOf(robot1), 1950 ether, "a pause keeps it");
        update(serviceId, 80 ether, ServiceState.Retired);
        assertEq(coin.balanceOf(robot1), 2000 ether);
        assertEq(services.service(serviceId).bond, 0);
    }

    function test_retiringAtWorkReturnsTheBondWhenTheTaskEnds() public {
        setTerms(50 ether, 20 ether, 1);
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        update(serviceId, 80 ether, ServiceState.Retired);
        assertEq(coin.balanceOf(robot1), 1950 ether);
        attempt(taskId, false);
        assertEq(coin.balanceOf(robot1), 1980 ether, "less the penalty");
        assertEq(uint8(services.service(serviceId).state), uint8(ServiceState.Retired));
        assertEq(coin.balanceOf(address(tasks)), 100 ether);
    }

    function test_retiringAtWorkPaysBondAndPriceOnAcceptance() public {
        setTerms(50 ether, 20 ether, 1);
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        update(serviceId, 80 ether, ServiceState.Retired);
        attempt(taskId, true);
        assertEq(coin.balanceOf(robot1), 2080 ether);
        assertEq(coin.balanceOf(address(tasks)), 0);
    }

    function test_changedTermsAreForNewServicesOnly() public {
        setTerms(50 ether, 20 ether, 0);
        ServiceId serviceId = offer(robot1, 80 ether);
        vm.expectEmit(address(organization));
        emit IOrganization.TermsChanged(500 ether, 500 ether, 1);
        setTerms(500 ether, 500 ether, 1);
        assertEq(organization.terms().bond, 500 ether);
        attempt(post(alice, 100 ether), false);
        assertEq(services.service(serviceId).bond, 30 ether);
        assertEq(uint8(services.service(serviceId).state), uint8(ServiceState.Active));
    }

    function test_aPenaltyIsAtMostTheBond() public {
        vm.expectRevert(abi.encodeWithSelector(IOrganization.InvalidTerms.selector, 1, 2, 3));
        vm.prank(admin);
        organization.setTerms(Terms(1, 2, 3));
    }

    // -- suspension by the organization -------------------------------------------------------------------

    function test_theOrganizationSuspendsAndReinstates() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        vm.startPrank(admin);
        vm.expectRevert(
            abi.encodeWithSelector(
                IServiceManager.ServiceNotSuspended.selector, serviceId, ServiceState.Active
            )
        );
        organization.reinstateService(serviceId);
        organization.suspendService(serviceId);
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.ServiceIsSuspended.selector, serviceId));
        organization.suspendService(serviceId);
        vm.stopPrank();
        TaskId taskId = post(alice, 100 ether);
        assertState(taskId, TaskState.Open);
        vm.expectEmit(address(services));
        emit IServiceManager.ServiceReinstated(serviceId);
        vm.prank(admin);
        organization.reinstateService(serviceId);
        assertEq(uint8(services.service(serviceId).state), uint8(ServiceState.Paused));
        update(serviceId, 80 ether, ServiceState.Active);
        assertAssigned(taskId, serviceId);
    }

    function test_whatIsRetiredIsNotSuspended() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        update(serviceId, 80 ether, ServiceState.Retired);
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.ServiceIsRetired.selector, serviceId));
        vm.prank(admin);
        organization.suspendService(serviceId);
    }

    function test_reinstatingForgivesFailures() public {
        setTerms(0, 0, 2);
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        attempt(taskId, false);
        attempt(taskId, false);
        vm.prank(admin);
        organization.reinstateService(serviceId);
        assertEq(services.service(serviceId).failures, 0);
    }

    function test_onlyTheOrganizationSuspends() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        bytes memory refusal = abi.encodeWithSelector(IServiceManager.NotOrganization.selector, admin);
        vm.startPrank(admin);
        vm.expectRevert(refusal);
        services.suspend(serviceId);
        vm.expectRevert(refusal);
        services.reinstate(serviceId);
    }

    function test_onlyTheServiceManagerMovesBonds() public {
        bytes memory refusal = abi.encodeWithSelector(ITaskManager.NotServiceManager.selector, stranger);
        vm.startPrank(stranger);
        vm.expectRevert(refusal);
        tasks.enter(serviceNo(1), alice, 1 ether);
        vm.expectRevert(refusal);
        tasks.returnBond(stranger, 1 ether);
    }

    function testFuzz_theBondIsSplitBetweenProviderAndTreasury(
        uint96 bond,
        uint96 penalty,
        uint8 maxFailures,
        uint8 attempts
    ) public {
        bond = uint96(bound(bond, 0, 1000 ether));
        penalty = uint96(bound(penalty, 0, bond));
        attempts = uint8(bound(attempts, 0, 12));
        setTerms(bond, penalty, maxFailures);
        ServiceId serviceId = offer(robot1, 80 ether);
        for (uint256 i = 0; i < attempts; ++i) {
            TaskId taskId = post(alice, 100 ether);
            if (state(taskId) == TaskState.Assigned) attempt(taskId, false);
            if (state(taskId) == TaskState.Assigned) attempt(taskId, true);
            if (state(taskId) != TaskState.Open) continue;
            vm.prank(alice);
            tasks.cancelTask(taskId);
        }
        uint256 left = services.service(serviceId).bond;
        assertEq(coin.balanceOf(address(tasks)), left);
        uint256 lost = bond - left;
        assertEq(coin.balanceOf(address(organization)), 2000 ether + lost);
        uint256 earned = services.service(serviceId).completed * 80 ether;
        update(serviceId, 80 ether, ServiceState.Retired);
        assertEq(coin.balanceOf(robot1), 2000 ether + earned - lost);
        assertEq(coin.balanceOf(address(tasks)), 0);
    }

    function test_countersStopAtTheirGreatestValue() public {
        setTerms(0, 0, 255);
        ServiceId serviceId = offer(robot1, 80 ether);
        // The word that tasks change: completed, rejected and expired at the brink.
        bytes32 slot = bytes32(uint256(keccak256(abi.encode(serviceId, uint256(1)))) + 1);
        uint256 word = uint256(vm.load(address(services), slot));
        vm.store(address(services), slot, bytes32(word | (((1 << 56) - 1) << 40)));
        assertEq(services.service(serviceId).completed, type(uint24).max);
        vm.startPrank(address(tasks));
        services.release(serviceId, Outcome.Completed, 0, alice, 0);
        services.release(serviceId, Outcome.Rejected, 0, alice, 0);
        services.release(serviceId, Outcome.Expired, 0, alice, 0);
        assertEq(services.service(serviceId).completed, type(uint24).max);
        assertEq(services.service(serviceId).rejected, type(uint16).max);
        assertEq(services.service(serviceId).expired, type(uint16).max);
        for (uint256 i = 0; i < 300; ++i) {
            services.release(serviceId, Outcome.Rejected, 0, alice, 0);
        }
        assertEq(services.service(serviceId).failures, type(uint8).max);
    }

    // -- all services of a provider -----------------------------------------------------------------------

    function test_whoFailedTooOftenGetsNoTasksForItsOtherServices() public {
        setTerms(0, 0, 1);
        ServiceId first = offer(robot1, 1 ether);
        ServiceId waiting = offer(robot1, 1 ether);
        ServiceId paused = offer(robot1, 1 ether);
        ServiceId other = offer(robot2, 1 ether);
        update(paused, 1 ether, ServiceState.Paused);
        TaskRequest memory r = request(10 ether);
        r.maxAttempts = 1;
        vm.prank(alice);
        attempt(tasks.registerTask(r), false);
        ServiceId[3] memory all = [first, waiting, paused];
        for (uint256 i = 0; i < 3; ++i) {
            assertEq(uint8(services.service(all[i]).state), uint8(ServiceState.Suspended));
            assertEq(services.service(all[i]).place, 0);
        }
        assertAssigned(post(alice, 10 ether), other);
    }

    function test_theServicesOfADismissedMemberLeaveTheLine() public {
        address[2] memory robots = [robot1, robot2];
        for (uint256 i = 0; i < 2; ++i) {
            vm.prank(admin);
            organization.grantRole(MEMBER_ROLE, robots[i]);
        }
        vm.prank(admin);
        organization.setMembersOnly(true);
        ServiceId gone = offer(robot1, 1 ether);
        ServiceId here = offer(robot2, 1 ether);
        vm.prank(admin);
        organization.grantRole(MEMBER_ROLE, alice);
        vm.prank(admin);
        organization.revokeRole(MEMBER_ROLE, robot1);
        assertEq(uint8(services.service(gone).state), uint8(ServiceState.Suspended));
        assertAssigned(post(alice, 10 ether), here);
        assertState(post(alice, 10 ether), TaskState.Open);
    }

    function test_whereEverybodyTakesPartADismissedMemberDoes() public {
        vm.prank(admin);
        organization.grantRole(MEMBER_ROLE, robot1);
        ServiceId serviceId = offer(robot1, 1 ether);
        vm.prank(admin);
        organization.revokeRole(MEMBER_ROLE, robot1);
        assertAssigned(post(alice, 10 ether), serviceId);
    }

    function test_onlyTheOrganizationSuspendsAProvider() public {
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.NotOrganization.selector, stranger));
        vm.prank(stranger);
        services.suspendServicesOf(robot1);
    }

    function test_aSuspendedProvidersServicesLeaveTheLineAtOnce() public {
        ServiceId first = offer(robot1, 1 ether);
        ServiceId second = offer(robot1, 2 ether);
        ServiceId other = offer(robot2, 80 ether);
        vm.expectEmit(address(organization));
        emit IOrganization.ProviderSuspended(robot1);
        vm.prank(admin);
        organization.suspendProvider(robot1);
        assertTrue(organization.isSuspended(robot1));
        assertEq(uint8(services.service(first).state), uint8(ServiceState.Suspended));
        assertEq(uint8(services.service(second).state), uint8(ServiceState.Suspended));
        assertAssigned(post(alice, 100 ether), other);
        assertState(post(alice, 100 ether), TaskState.Open);
    }

    function test_aSuspendedProviderRegistersNoServiceUntilItIsReinstated() public {
        ServiceId serviceId = offer(robot1, 1 ether);
        bytes memory refusal = abi.encodeWithSelector(IOrganization.ProviderIsSuspended.selector, robot1);
        vm.startPrank(admin);
        organization.suspendProvider(robot1);
        vm.expectRevert(refusal);
        organization.suspendProvider(robot1);
        vm.expectRevert(refusal);
        organization.reinstateService(serviceId);
        vm.stopPrank();
        vm.expectRevert(refusal);
        offer(robot1, 1 ether);
        vm.expectEmit(address(organization));
        emit IOrganization.ProviderReinstated(robot1);
        vm.startPrank(admin);
        organization.reinstateProvider(robot1);
        vm.expectRevert(abi.encodeWithSelector(IOrganization.ProviderNotSuspended.selector, robot1));
        organization.reinstateProvider(robot1);
        assertEq(uint8(services.service(serviceId).state), uint8(ServiceState.Suspended));
        organization.reinstateService(serviceId);
        vm.stopPrank();
        assertEq(uint8(services.service(serviceId).state), uint8(ServiceState.Paused));
        assertAssigned(post(alice, 10 ether), offer(robot1, 1 ether));
    }

    function test_aSuspendedProviderFinishesItsTaskAndTakesItsBondBack() public {
        setTerms(20 ether, 5 ether, 0);
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        uint256 before = coin.balanceOf(robot1);
        vm.prank(admin);
        organization.suspendProvider(robot1);
        attempt(taskId, true);
        assertState(taskId, TaskState.Settled);
        update(serviceId, 80 ether, ServiceState.Retired);
        assertEq(coin.balanceOf(robot1), before + 80 ether + 20 ether);
    }

    function test_theOrganizationIsNotSuspendedAsAProvider() public {
        vm.expectRevert(IOrganization.OrganizationIsProvider.selector);
        vm.prank(admin);
        organization.suspendProvider(address(organization));
    }
}
