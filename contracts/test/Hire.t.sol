// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IServiceManager, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {ITaskQueues} from "../src/interfaces/ITaskQueues.sol";
import {
    Cause,
    Hire,
    ITaskManager,
    Task,
    TaskRequest,
    TaskState,
    Ruling
} from "../src/interfaces/ITaskManager.sol";
import {NO_SERVICE, ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";

/// @notice Tasks that name the service, or the provider, that is to do them.
contract HireTest is Fixture {
    function _hire(ServiceId serviceId, uint256 reward) private returns (TaskId) {
        TaskRequest memory r = request(reward);
        r.serviceId = serviceId.pack();
        vm.prank(alice);
        return tasks.registerTask(r);
    }

    function _hireFrom(address provider, uint256 reward) private returns (TaskId) {
        TaskRequest memory r = request(reward);
        r.provider = provider;
        vm.prank(alice);
        return tasks.registerTask(r);
    }

    /// @dev robot1 has two services, and both are at work.
    function _twoBusy() private returns (ServiceId first, ServiceId second) {
        (first, second) = (offer(robot1, 80 ether), offer(robot1, 60 ether));
        post(bob, 100 ether);
        post(bob, 100 ether);
        assertAssigned(taskNo(1), first);
        assertAssigned(taskNo(2), second);
    }

    function test_theNamedServiceGetsTheTaskWhoeverIsCheaperAndWaitedLonger() public {
        offer(robot1, 1 ether);
        ServiceId second = offer(robot2, 80 ether);
        vm.expectEmit();
        emit ITaskManager.ServiceRequested(taskNo(1), second);
        TaskId taskId = _hire(second, 100 ether);
        assertAssigned(taskId, second);
        assertTrue(tasks.task(taskId).hired == Hire.Service);
        assertEq(tasks.task(taskId).price, 80 ether, "its own price");
    }

    function test_whileTheNamedServiceWorksTheTaskWaitsForIt() public {
        ServiceId busy = offer(robot1, 80 ether);
        TaskId running = post(bob, 100 ether);
        TaskId taskId = _hire(busy, 100 ether);
        ServiceId other = offer(robot2, 1 ether);
        assertState(taskId, TaskState.Open);
        assertEq(tasks.task(taskId).serviceId, busy, "whom it waits for");
        TaskId later = post(bob, 100 ether);
        assertAssigned(later, other);
        attempt(running, true);
        assertAssigned(taskId, busy);
        attempt(taskId, true);
        assertEq(coin.balanceOf(alice), 1920 ether);
    }

    function test_theOldestTaskGoesFirstWhetherItNamesTheServiceOrNot() public {
        ServiceId busy = offer(robot1, 80 ether);
        post(bob, 100 ether);
        TaskId any = post(bob, 100 ether);
        TaskId named = _hire(busy, 100 ether);
        TaskId last = post(bob, 100 ether);
        attempt(taskNo(1), true);
        assertAssigned(any, busy);
        attempt(any, true);
        assertAssigned(named, busy);
        attempt(named, true);
        assertAssigned(last, busy);
    }

    function test_aFailedAttemptWaitsForTheNamedServiceAgain() public {
        ServiceId first = offer(robot1, 80 ether);
        ServiceId other = offer(robot2, 1 ether);
        TaskId taskId = _hire(first, 100 ether);
        attempt(taskId, false);
        assertAssigned(taskId, first);
        assertEq(tasks.task(taskId).attempt, 2);
        assertEq(services.service(other).taskId, 0);
    }

    function test_aTaskThatPaysThePriceOfWhomItNamesExactlyWaitsForIt() public {
        ServiceId busy = offer(robot1, 12.345 ether);
        TaskId running = post(bob, 100 ether);
        TaskId taskId = _hire(busy, 12.345 ether);
        TaskId ofProvider = _hireFrom(robot1, 12.345 ether);
        attempt(running, true);
        assertAssigned(taskId, busy);
        attempt(taskId, true);
        assertAssigned(ofProvider, busy);
        assertEq(tasks.task(ofProvider).price, 12.345 ether);
    }

    function test_aTaskThatPaysTooLittleKeepsNoServiceFromItsNext() public {
        ServiceId busy = offer(robot1, 12.345 ether);
        TaskId running = post(bob, 100 ether);
        TaskId cheap = _hire(busy, 12.34 ether); // of the level that 12.345 is of
        TaskId taskId = _hire(busy, 12.4 ether);
        attempt(running, true);
        assertAssigned(taskId, busy);
        assertState(cheap, TaskState.Open);
    }

    /// @dev Otherwise anybody could keep those that pay exactly waiting, for a reward that is refunded.
    function test_aTaskThatPaysTooLittleIsNotInTheWayOfOneThatPaysExactly() public {
        ServiceId busy = offer(robot1, 12.345 ether);
        TaskId running = post(bob, 100 ether);
        TaskId[2] memory cheap = [_hire(busy, 12.34 ether), _hireFrom(robot1, 12.344999999 ether)];
        TaskId taskId = _hire(busy, 12.345 ether);
        TaskId ofProvider = _hireFrom(robot1, 12.345 ether);
        attempt(running, true);
        assertAssigned(taskId, busy);
        attempt(taskId, true);
        assertAssigned(ofProvider, busy);
        attempt(ofProvider, true);
        assertState(cheap[0], TaskState.Open);
        assertState(cheap[1], TaskState.Open);
    }

    function test_aRewardAboveTheGreatestPricePaysForEach() public {
        uint256 price = ((uint256(1) << 57) - 2) * 1 gwei;
        ServiceId busy = offer(robot1, price);
        deal(address(coin), alice, 3 * (price + 1 ether));
        TaskId running = _hire(busy, price);
        TaskId taskId = _hire(busy, price + 1 ether);
        attempt(running, true);
        assertAssigned(taskId, busy);
    }

    function test_whoIsNamedAndGivesTheTaskBackDoesNotGetItAgain() public {
        ServiceId named = offer(robot1, 80 ether);
        for (uint256 i = 0; i < 2; ++i) {
            TaskId taskId = i == 0 ? _hire(named, 100 ether) : _hireFrom(robot1, 100 ether);
            vm.expectEmit();
            emit ITaskManager.TaskFailed(taskId, 100 ether, 1, Cause.Abandoned);
            vm.prank(robot1);
            tasks.abandonTask(taskId, 1);
            assertState(taskId, TaskState.Failed);
            assertEq(coin.balanceOf(alice), 2000 ether, "the reward is back");
            assertEq(services.service(named).taskId, 0);
            assertEq(services.service(named).expired, 0, "nobody failed");
        }
    }

    function test_aTaskWaitsForAPausedServiceAndItsCreatorCancelsIt() public {
        ServiceId paused = offer(robot1, 80 ether);
        update(paused, 80 ether, ServiceState.Paused);
        TaskId taskId = _hire(paused, 100 ether);
        TaskId cancelled = _hire(paused, 100 ether);
        assertState(taskId, TaskState.Open);
        vm.prank(alice);
        tasks.cancelTask(cancelled);
        assertEq(coin.balanceOf(alice), 1900 ether);
        update(paused, 80 ether, ServiceState.Active);
        assertAssigned(taskId, paused);
        attempt(taskId, true);
        assertEq(services.service(paused).taskId, 0, "the cancelled task is gone");
    }

    function test_aTaskThatPaysTooLittleWaitsUntilTheServiceIsCheaper() public {
        ServiceId dear = offer(robot1, 80 ether);
        TaskId taskId = _hire(dear, 50 ether);
        assertState(taskId, TaskState.Open);
        vm.prank(stranger);
        tasks.matchTask(taskId, NO_SERVICE);
        assertState(taskId, TaskState.Open);
        update(dear, 50 ether, ServiceState.Active);
        assertAssigned(taskId, dear);
    }

    function test_aServiceThatDoesNotExistOrDoesOtherWorkIsNotHired() public {
        vm.prank(robot1);
        ServiceId charger = services.registerService(CHARGING, 1 ether, NO_LIMIT, true, "");
        TaskRequest memory r = request(100 ether);
        r.serviceId = 2;
        vm.startPrank(alice);
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.UnknownService.selector, 2));
        tasks.registerTask(r);
        r.serviceId = charger.pack();
        // The kind has its number once somebody has used it.
        vm.expectRevert(
            abi.encodeWithSelector(IServiceManager.ServiceOfOtherKind.selector, charger, CLEANING)
        );
        tasks.registerTask(r);
        vm.stopPrank();
    }

    function test_theCheapestFreeServiceOfTheNamedProviderGetsTheTask() public {
        offer(robot2, 1 ether);
        offer(robot1, 80 ether);
        ServiceId cheap = offer(robot1, 60 ether);
        vm.expectEmit();
        emit ITaskManager.ProviderRequested(taskNo(1), robot1);
        TaskId taskId = _hireFrom(robot1, 100 ether);
        assertAssigned(taskId, cheap);
        Task memory t = tasks.task(taskId);
        assertTrue(t.hired == Hire.Provider);
        assertEq(t.provider, robot1);
        assertEq(t.price, 60 ether, "its own price");
    }

    function test_whicheverServiceOfTheNamedProviderIsFreeFirstTakesTheWaitingTask() public {
        (, ServiceId second) = _twoBusy();
        TaskId taskId = _hireFrom(robot1, 100 ether);
        ServiceId other = offer(robot2, 1 ether);
        Task memory t = tasks.task(taskId);
        assertState(taskId, TaskState.Open);
        assertEq(t.serviceId, 0, "it names no service");
        assertEq(t.provider, robot1);
        assertEq(services.service(other).taskId, 0);
        attempt(taskNo(2), true);
        assertAssigned(taskId, second);
        attempt(taskId, true);
        assertState(taskId, TaskState.Settled);
    }

    function test_aServiceTakesTheOldestOfItsThreeQueues() public {
        (ServiceId first,) = _twoBusy();
        TaskId fromProvider = _hireFrom(robot1, 100 ether);
        TaskId named = _hire(first, 100 ether);
        TaskId any = post(bob, 100 ether);
        TaskId last = _hireFrom(robot1, 100 ether);
        TaskId[4] memory order = [fromProvider, named, any, last];
        TaskId running = taskNo(1);
        for (uint256 i = 0; i < 4; ++i) {
            attempt(running, true);
            running = order[i];
            assertAssigned(running, first);
        }
    }

    function test_aFailedAttemptGoesToAnotherServiceOfTheNamedProviderOrWaitsForOne() public {
        ServiceId first = offer(robot1, 60 ether);
        TaskId taskId = _hireFrom(robot1, 100 ether);
        assertAssigned(taskId, first);
        ServiceId second = offer(robot1, 80 ether);
        offer(robot2, 1 ether);
        attempt(taskId, false);
        assertAssigned(taskId, second);
        assertEq(tasks.task(taskId).price, 80 ether);
        update(first, 60 ether, ServiceState.Paused);
        attempt(taskId, false);
        assertAssigned(taskId, second);
    }

    function test_aTaskWaitsForAProviderWhoRetiredWhileItsProofWasAudited() public {
        ServiceId first = offer(robot1, 60 ether);
        TaskId taskId = _hireFrom(robot1, 100 ether);
        submit(taskId);
        judgeAs(oracle, taskId, Ruling.None, 0);
        update(first, 60 ether, ServiceState.Retired);
        judgeAs(auditor, taskId, Ruling.Rejected, 0);
        assertState(taskId, TaskState.Open);
        vm.prank(stranger);
        tasks.matchTask(taskId, NO_SERVICE);
        assertState(taskId, TaskState.Open);
        assertAssigned(taskId, offer(robot1, 90 ether));
    }

    function test_aServiceOfTheNamedProviderThatComesLaterTakesWaitingTasksToo() public {
        _twoBusy();
        TaskId taskId = _hireFrom(robot1, 100 ether);
        TaskId cancelled = _hireFrom(robot1, 100 ether);
        TaskId later = _hireFrom(robot1, 100 ether);
        vm.prank(alice);
        tasks.cancelTask(cancelled);
        assertEq(tasks.task(cancelled).serviceId, 0, "nobody has done it");
        ServiceId third = offer(robot1, 70 ether);
        assertAssigned(taskId, third);
        attempt(taskId, true);
        assertAssigned(later, third);
        attempt(later, true);
        assertEq(services.service(third).taskId, 0, "the cancelled task is gone");
    }

    function test_aTaskThatPaysANamedProviderTooLittleWaitsUntilOneIsCheaper() public {
        offer(robot1, 80 ether);
        ServiceId second = offer(robot1, 90 ether);
        TaskId taskId = _hireFrom(robot1, 50 ether);
        assertState(taskId, TaskState.Open);
        update(second, 50 ether, ServiceState.Active);
        assertAssigned(taskId, second);
    }

    function test_whoDoesNoSuchWorkAndTheOrganizationAreNotHired() public {
        vm.prank(robot1);
        services.registerService(CHARGING, 1 ether, NO_LIMIT, true, "");
        ServiceId retired = offer(robot2, 1 ether);
        update(retired, 1 ether, ServiceState.Retired);
        vm.prank(admin);
        organization.registerService(CLEANING, 1 ether, NO_LIMIT, true, "");
        address[4] memory named = [robot1, robot2, address(organization), stranger];
        for (uint256 i = 0; i < 4; ++i) {
            TaskRequest memory r = request(100 ether);
            r.provider = named[i];
            vm.prank(alice);
            vm.expectRevert(
                abi.encodeWithSelector(IServiceManager.ProviderWithoutService.selector, named[i], CLEANING)
            );
            tasks.registerTask(r);
        }
    }

    function test_aTaskNamesAServiceOrAProviderNotBoth() public {
        TaskRequest memory r = request(100 ether);
        (r.serviceId, r.provider) = (offer(robot1, 1 ether).pack(), robot1);
        vm.prank(alice);
        vm.expectRevert(abi.encodeWithSelector(ITaskQueues.TwoNamed.selector, 1, robot1));
        tasks.registerTask(r);
    }
}
