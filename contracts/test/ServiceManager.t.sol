// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IOrganization} from "../src/interfaces/IOrganization.sol";
import {Outcome} from "../src/interfaces/IProviders.sol";
import {IServiceManager, Service, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {Hire, TaskState} from "../src/interfaces/ITaskManager.sol";
import {NOBODY} from "../src/types/Passed.sol";
import {KindId} from "../src/types/KindId.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";

contract ServiceManagerTest is Fixture {
    function test_aServiceIsRegisteredForItsProvider() public {
        vm.expectEmit(address(services));
        emit IServiceManager.ServiceRegistered(
            serviceNo(1), robot1, CLEANING, 80 ether, true, "collects trash"
        );
        vm.prank(robot1);
        ServiceId serviceId = services.registerService(CLEANING, 80 ether, NO_LIMIT, true, "collects trash");
        Service memory s = services.service(serviceId);
        assertEq(s.provider, robot1);
        assertEq(s.price, 80 ether);
        assertEq(s.kind, CLEANING);
        assertEq(uint8(s.state), uint8(ServiceState.Active));
    }

    function test_anUnknownKindIsRefused() public {
        vm.expectRevert(abi.encodeWithSelector(IOrganization.UnknownKind.selector, bytes32("painting")));
        services.registerService("painting", 1 ether, NO_LIMIT, true, "");
    }

    function test_aPriceIsAWholeNumberOfUnitsAndBounded() public {
        uint256 max = ((1 << 57) - 2) * 1 gwei;
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.InvalidPrice.selector, 1, 1 gwei, max));
        services.registerService(CLEANING, 1, NO_LIMIT, true, "");
        vm.expectRevert(
            abi.encodeWithSelector(IServiceManager.InvalidPrice.selector, max + 1 gwei, 1 gwei, max)
        );
        services.registerService(CLEANING, max + 1 gwei, NO_LIMIT, true, "");
        offer(robot1, max);
    }

    function test_onlyTheProviderUpdates() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        vm.expectRevert(
            abi.encodeWithSelector(IServiceManager.NotProvider.selector, serviceId, stranger, robot1)
        );
        vm.prank(stranger);
        services.updateService(serviceId, 1 ether, ServiceState.Active);
    }

    function test_aPausedServiceGetsNoTaskUntilItIsActiveAgain() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        vm.prank(robot1);
        services.updateService(serviceId, 80 ether, ServiceState.Paused);
        TaskId taskId = post(alice, 100 ether);
        assertState(taskId, TaskState.Open);
        vm.expectEmit(address(services));
        emit IServiceManager.ServiceUpdated(serviceId, 80 ether, ServiceState.Active);
        vm.prank(robot1);
        services.updateService(serviceId, 80 ether, ServiceState.Active);
        assertAssigned(taskId, serviceId);
    }

    function test_aLowerPriceFindsAWaitingTask() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 50 ether);
        vm.prank(robot1);
        services.updateService(serviceId, 50 ether, ServiceState.Active);
        assertAssigned(taskId, serviceId);
    }

    function test_aProviderCannotFreeItselfFromARunningTask() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        TaskId waiting = post(bob, 100 ether);
        vm.startPrank(robot1);
        services.updateService(serviceId, 80 ether, ServiceState.Paused);
        services.updateService(serviceId, 80 ether, ServiceState.Active);
        vm.stopPrank();
        assertAssigned(taskId, serviceId);
        assertState(waiting, TaskState.Open);
    }

    function test_aServicePausedAtWorkFinishesAndThenRests() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.prank(robot1);
        services.updateService(serviceId, 80 ether, ServiceState.Paused);
        submit(taskId);
        judge(taskId, true);
        assertEq(services.service(serviceId).completed, 1);
        assertState(post(alice, 100 ether), TaskState.Open);
    }

    function test_retiringIsForGood() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        vm.startPrank(robot1);
        services.updateService(serviceId, 80 ether, ServiceState.Retired);
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.ServiceIsRetired.selector, serviceId));
        services.updateService(serviceId, 80 ether, ServiceState.Active);
    }

    function test_noneIsNoStateToSet() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        vm.expectRevert(
            abi.encodeWithSelector(IServiceManager.InvalidServiceState.selector, ServiceState.None)
        );
        vm.prank(robot1);
        services.updateService(serviceId, 80 ether, ServiceState.None);
    }

    function test_aServiceThatDoesNotExistIsUnknown() public {
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.UnknownService.selector, 7));
        services.service(serviceNo(7));
    }

    function test_onlyTheTaskManagerOccupiesAndFrees() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        bytes memory refusal = abi.encodeWithSelector(IServiceManager.NotTaskManager.selector, robot1);
        vm.startPrank(robot1);
        vm.expectRevert(refusal);
        services.reserve(serviceId, KindId.wrap(1), 100 ether, NOBODY, taskNo(1), Hire.None);
        vm.expectRevert(refusal);
        services.release(serviceId, Outcome.Completed, 80 ether, alice, 0);
        vm.expectRevert(refusal);
        services.enqueue(serviceId, 1);
    }

    function test_aServiceDoesOneTaskAtATime() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.startPrank(address(tasks));
        (, address provider,,) =
            services.reserve(serviceId, KindId.wrap(1), 100 ether, NOBODY, taskNo(2), Hire.None);
        assertEq(provider, address(0), "refused");
        assertAssigned(taskId, serviceId);
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.ServiceNotIdle.selector, serviceId));
        services.enqueue(serviceId, 1);
    }
}
