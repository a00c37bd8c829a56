// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IMatchingPolicy} from "../src/interfaces/IMatchingPolicy.sol";
import {IServiceManager, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {ITaskManager, TaskRequest, TaskState} from "../src/interfaces/ITaskManager.sol";
import {Fixture} from "./Fixture.sol";

/// @notice Names a service and a price.
contract FixedPolicy is IMatchingPolicy {
    uint256 private immutable _price;

    constructor(uint256 price) {
        _price = price;
    }

    function serviceFor(IServiceManager, bytes32, uint256) external view returns (uint256, uint256) {
        return (1, _price);
    }
}

/// @notice Tasks that name the service that is to do them.
contract HireTest is Fixture {
    function _hire(uint256 serviceId, uint256 reward) private returns (uint256) {
        TaskRequest memory r = request(reward);
        r.serviceId = uint32(serviceId);
        vm.prank(alice);
        return tasks.registerTask(r);
    }

    function test_theNamedServiceGetsTheTaskWhoeverIsCheaperAndWaitedLonger() public {
        offer(robot1, 1 ether);
        uint256 second = offer(robot2, 80 ether);
        vm.expectEmit();
        emit ITaskManager.ServiceRequested(1, second);
        uint256 taskId = _hire(second, 100 ether);
        assertAssigned(taskId, second);
        assertTrue(tasks.task(taskId).hired);
        assertEq(tasks.task(taskId).price, 80 ether, "its own price");
    }

    function test_whileTheNamedServiceWorksTheTaskWaitsForIt() public {
        uint256 busy = offer(robot1, 80 ether);
        uint256 running = post(bob, 100 ether);
        uint256 taskId = _hire(busy, 100 ether);
        uint256 other = offer(robot2, 1 ether);
        assertState(taskId, TaskState.Open);
        assertEq(tasks.task(taskId).serviceId, busy, "whom it waits for");
        uint256 later = post(bob, 100 ether);
        assertAssigned(later, other);
        attempt(running, true);
        assertAssigned(taskId, busy);
        attempt(taskId, true);
        assertEq(coin.balanceOf(alice), 1920 ether);
    }

    function test_theOldestTaskGoesFirstWhetherItNamesTheServiceOrNot() public {
        uint256 busy = offer(robot1, 80 ether);
        post(bob, 100 ether);
        uint256 any = post(bob, 100 ether);
        uint256 named = _hire(busy, 100 ether);
        uint256 last = post(bob, 100 ether);
        attempt(1, true);
        assertAssigned(any, busy);
        attempt(any, true);
        assertAssigned(named, busy);
        attempt(named, true);
        assertAssigned(last, busy);
    }

    function test_aFailedAttemptWaitsForTheNamedServiceAgain() public {
        uint256 first = offer(robot1, 80 ether);
        uint256 other = offer(robot2, 1 ether);
        uint256 taskId = _hire(first, 100 ether);
        attempt(taskId, false);
        assertAssigned(taskId, first);
        assertEq(tasks.task(taskId).attempt, 2);
        assertEq(services.service(other).taskId, 0);
    }

    function test_aTaskWaitsForAPausedServiceAndItsCreatorCancelsIt() public {
        uint256 paused = offer(robot1, 80 ether);
        update(paused, 80 ether, ServiceState.Paused);
        uint256 taskId = _hire(paused, 100 ether);
        uint256 cancelled = _hire(paused, 100 ether);
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
        uint256 dear = offer(robot1, 80 ether);
        uint256 taskId = _hire(dear, 50 ether);
        assertState(taskId, TaskState.Open);
        vm.prank(stranger);
        tasks.matchTask(taskId);
        assertState(taskId, TaskState.Open);
        update(dear, 50 ether, ServiceState.Active);
        assertAssigned(taskId, dear);
    }

    function test_aServiceThatDoesNotExistOrDoesOtherWorkIsNotHired() public {
        vm.prank(robot1);
        uint256 charger = services.registerService(CHARGING, 1 ether, NO_LIMIT, true, "");
        TaskRequest memory r = request(100 ether);
        r.serviceId = 2;
        vm.startPrank(alice);
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.UnknownService.selector, 2));
        tasks.registerTask(r);
        r.serviceId = uint32(charger);
        // The kind has its number once somebody has used it.
        vm.expectRevert(
            abi.encodeWithSelector(IServiceManager.ServiceOfOtherKind.selector, charger, CLEANING)
        );
        tasks.registerTask(r);
        vm.stopPrank();
    }

    function test_aPolicyPaysAtLeastTheServicesPriceAndAtMostTheReward() public {
        uint256 serviceId = offer(robot1, 80 ether);
        uint256[3] memory named = [uint256(1 ether), 90 ether, 101 ether];
        for (uint256 i = 0; i < 3; ++i) {
            IMatchingPolicy policy_ = new FixedPolicy(named[i]);
            vm.prank(admin);
            organization.setPolicy(policy_);
            if (i == 2) {
                vm.expectEmit();
                emit ITaskManager.PolicyFailed(3);
            }
            uint256 taskId = post(alice, 100 ether);
            if (i == 2) {
                assertState(taskId, TaskState.Open);
                continue;
            }
            assertAssigned(taskId, serviceId);
            assertEq(tasks.task(taskId).price, i == 0 ? 80 ether : 90 ether);
            attempt(taskId, true);
        }
    }
}
