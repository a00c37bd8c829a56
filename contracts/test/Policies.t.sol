// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";
import {IMatchingPolicy} from "../src/interfaces/IMatchingPolicy.sol";
import {Choice, Service, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {ITaskManager, TaskRequest, TaskState, Ruling} from "../src/interfaces/ITaskManager.sol";
import {ITaskQueues} from "../src/interfaces/ITaskQueues.sol";
import {Units} from "../src/libraries/Units.sol";
import {HighestReputation} from "../src/policies/HighestReputation.sol";
import {LowestPrice} from "../src/policies/LowestPrice.sol";
import {NOBODY} from "../src/types/Passed.sol";
import {NO_SERVICE, ServiceId} from "../src/types/ServiceId.sol";
import {NO_TASK, TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";
import {SlowPolicy, StubPolicy, TaskStubPolicy, Way} from "./StubPolicies.sol";

contract PolicyTest is Fixture {
    IMatchingPolicy private _lowestPrice;
    IMatchingPolicy private _highestReputation;

    function setUp() public override {
        super.setUp();
        _lowestPrice = LowestPrice(deployed("LowestPrice"));
        _highestReputation = HighestReputation(deployed("HighestReputation"));
    }

    function _use(IMatchingPolicy policy_) private {
        vm.prank(admin);
        organization.setPolicy(policy_);
    }

    // -- first come, first served -------------------------------------------------------------------------

    function test_firstCome_thePriceDoesNotMatter() public {
        ServiceId dear = offer(robot1, 90 ether);
        ServiceId cheap = offer(robot2, 10 ether);
        assertAssigned(post(alice, 100 ether), dear);
        assertAssigned(post(alice, 100 ether), cheap);
    }

    function test_firstCome_reputationDoesNotMatter() public {
        ServiceId one = offer(robot1, 80 ether);
        attempt(post(alice, 100 ether), true);
        ServiceId two = offer(robot2, 80 ether);
        assertAssigned(post(alice, 100 ether), one);
        assertAssigned(post(alice, 100 ether), two);
    }

    // -- lowest price -------------------------------------------------------------------------------------

    function test_lowestPrice_theCheapestIsServedFirst() public {
        _use(_lowestPrice);
        ServiceId dear = offer(robot1, 90 ether);
        ServiceId cheap = offer(robot2, 10 ether);
        ServiceId middle = offer(robot3, 50 ether);
        assertAssigned(post(alice, 100 ether), cheap);
        assertAssigned(post(alice, 100 ether), middle);
        assertState(post(alice, 89 ether), TaskState.Open);
        assertAssigned(post(alice, 100 ether), dear);
    }

    function test_lowestPrice_ofEqualsTheOneOfBetterReputation() public {
        ServiceId one = offer(robot1, 80 ether);
        ServiceId two = offer(robot2, 80 ether);
        attempt(post(alice, 100 ether), false);
        attempt(taskNo(1), true);
        assertGt(services.service(two).reputation, services.service(one).reputation);
        _use(_lowestPrice);
        assertAssigned(post(alice, 100 ether), two);
    }

    function test_lowestPrice_ofEqualsTheOneThatWaitedLongest() public {
        _use(_lowestPrice);
        ServiceId one = offer(robot1, 80 ether);
        ServiceId two = offer(robot2, 80 ether);
        assertAssigned(post(alice, 100 ether), one);
        assertAssigned(post(alice, 100 ether), two);
    }

    // -- highest reputation -------------------------------------------------------------------------------

    function test_highestReputation_theMostReliableIsServedFirst() public {
        _use(_highestReputation);
        ServiceId bad = offer(robot1, 10 ether);
        address[3] memory creators = [alice, bob, alice];
        for (uint256 i = 0; i < creators.length; ++i) {
            TaskId taskId = post(creators[i], 100 ether);
            submit(taskId);
            update(bad, 10 ether, ServiceState.Paused);
            judge(taskId, false);
            vm.prank(creators[i]);
            tasks.cancelTask(taskId);
            update(bad, 10 ether, ServiceState.Active);
        }
        ServiceId fresh = offer(robot2, 50 ether);
        vm.prank(robot3);
        ServiceId good = services.registerService(CLEANING, 90 ether, NO_LIMIT, true, "");
        update(bad, 10 ether, ServiceState.Paused);
        update(fresh, 50 ether, ServiceState.Paused);
        attempt(post(alice, 100 ether), true);
        update(bad, 10 ether, ServiceState.Active);
        update(fresh, 50 ether, ServiceState.Active);
        assertEq(services.service(bad).reputation, 27, "100 of 230");
        assertEq(services.service(fresh).reputation, 32, "100 of 200");
        assertEq(services.service(good).reputation, 41, "190 of 290");
        assertAssigned(post(alice, 100 ether), good);
        assertAssigned(post(alice, 100 ether), fresh);
        assertAssigned(post(alice, 100 ether), bad);
    }

    function test_highestReputation_whoCostsTooMuchIsLeftOut() public {
        ServiceId good = offer(robot1, 90 ether);
        attempt(post(alice, 100 ether), true);
        ServiceId fresh = offer(robot2, 50 ether);
        _use(_highestReputation);
        assertAssigned(post(alice, 60 ether), fresh);
        assertAssigned(post(alice, 90 ether), good);
    }

    function test_highestReputation_ofEqualsTheCheapest() public {
        _use(_highestReputation);
        offer(robot1, 90 ether);
        ServiceId cheap = offer(robot2, 50 ether);
        assertAssigned(post(alice, 100 ether), cheap);
    }

    // -- a service that becomes free ----------------------------------------------------------------------

    function test_theOldestTaskAtTheServicesPrice() public {
        IMatchingPolicy[3] memory policies = [IMatchingPolicy(policy), _lowestPrice, _highestReputation];
        for (uint256 i = 0; i < policies.length; ++i) {
            uint256 snapshot = vm.snapshotState();
            _use(policies[i]);
            post(alice, 5 ether);
            TaskId oldest = post(alice, 50 ether);
            post(alice, 100 ether);
            assertAssigned(oldest, offer(robot1, 10 ether));
            assertEq(tasks.task(oldest).price, 10 ether);
            vm.revertToState(snapshot);
        }
    }

    /// @dev Ways in which a service becomes free.
    enum Freed {
        Registered,
        Updated,
        Accepted,
        Impossible,
        Rejected,
        Undecided,
        Expired,
        Abandoned
    }

    /// @dev A service that asks 10 ether and is free after `_free`. Tasks 1 to 4 are of other services or over.
    function _busy(Freed how) private returns (ServiceId serviceId) {
        if (how == Freed.Registered) return serviceNo(services.serviceCount() + 1);
        serviceId = offer(robot1, 10 ether);
        if (how == Freed.Updated) update(serviceId, 20 ether, ServiceState.Paused);
        else post(alice, 10 ether);
    }

    function _free(Freed how, ServiceId serviceId) private {
        if (how == Freed.Registered) {
            offer(robot1, 10 ether);
            return;
        }
        if (how == Freed.Updated) {
            update(serviceId, 10 ether, ServiceState.Active);
            return;
        }
        TaskId taskId = services.service(serviceId).taskId;
        if (how == Freed.Abandoned) {
            vm.prank(robot1);
            tasks.abandonTask(taskId, 1);
            return;
        }
        if (how == Freed.Expired) {
            vm.warp(block.timestamp + WINDOW + 1);
            tasks.expireTask(taskId);
            return;
        }
        submit(taskId);
        if (how == Freed.Accepted || how == Freed.Rejected) judge(taskId, how == Freed.Accepted);
        else judgeAs(oracle, taskId, how == Freed.Undecided ? Ruling.None : Ruling.Impossible, 0);
    }

    /// @dev Whatever made it free.
    function test_thePolicyChoosesTheTaskOfAServiceThatBecomesFree() public {
        for (uint8 how = 0; how <= uint8(type(Freed).max); ++how) {
            uint256 snapshot = vm.snapshotState();
            TaskStubPolicy stub = new TaskStubPolicy();
            _use(stub);
            ServiceId serviceId = _busy(Freed(how));
            post(alice, 40 ether);
            TaskId chosen = post(bob, 50 ether);
            post(alice, 60 ether);
            stub.tell(Way.Answers, TaskId.unwrap(chosen));
            vm.expectCall(
                address(stub),
                abi.encodeCall(
                    IMatchingPolicy.taskFor, (tasks.queues(), services, cleaning(), serviceId, 10 ether)
                )
            );
            _free(Freed(how), serviceId);
            assertAssigned(chosen, serviceId);
            assertEq(tasks.task(chosen).price, 10 ether, "its own price");
            vm.revertToState(snapshot);
        }
    }

    function test_aChosenTaskMayPayExactlyWhatTheServiceAsks() public {
        TaskStubPolicy stub = new TaskStubPolicy();
        _use(stub);
        post(alice, 100 ether);
        TaskId exact = post(alice, 99.71 ether);
        stub.tell(Way.Answers, TaskId.unwrap(exact));
        assertAssigned(exact, offer(robot1, 99.71 ether));
    }

    /// @dev Task 1 is done, 2 runs, 3 is of another kind, 4 names robot3, 5 pays too little, 6 is the oldest that fits, 7 does
    /// as well.
    function _queue(TaskStubPolicy stub) private returns (ServiceId serviceId) {
        _use(stub);
        serviceId = offer(robot1, 10 ether);
        ServiceId other = offer(robot3, 10 ether);
        attempt(post(alice, 10 ether), true);
        update(serviceId, 10 ether, ServiceState.Paused);
        post(alice, 10 ether);
        TaskRequest memory r = request(50 ether);
        r.kind = CHARGING;
        vm.prank(alice);
        tasks.registerTask(r);
        r = request(50 ether);
        r.serviceId = other.pack();
        vm.prank(alice);
        tasks.registerTask(r);
        post(alice, 9 ether);
        post(alice, 40 ether);
        post(alice, 50 ether);
        assertAssigned(taskNo(2), other);
    }

    function test_attack_aPolicyThatAnswersBadlyHoldsUpNoService() public {
        TaskStubPolicy stub = new TaskStubPolicy();
        ServiceId serviceId = _queue(stub);
        uint256[9] memory unfit = [uint256(0), 1, 2, 3, 4, 5, 8, (1 << 40) + 7, type(uint256).max];
        for (uint256 i = 0; i < unfit.length; ++i) {
            _assertTakesTheOldest(stub, serviceId, Way.Answers, unfit[i]);
        }
        for (uint8 way = 1; way <= uint8(type(Way).max); ++way) {
            _assertTakesTheOldest(stub, serviceId, Way(way), 7);
        }
        vm.etch(address(stub), "");
        vm.expectEmit(address(tasks));
        emit ITaskManager.PolicyFailed(taskNo(6));
        update(serviceId, 10 ether, ServiceState.Active);
        assertAssigned(taskNo(6), serviceId);
    }

    function _assertTakesTheOldest(TaskStubPolicy stub, ServiceId serviceId, Way way, uint256 chosen)
        private
    {
        uint256 snapshot = vm.snapshotState();
        stub.tell(way, chosen);
        vm.expectEmit(address(tasks));
        emit ITaskManager.PolicyFailed(taskNo(6));
        update(serviceId, 10 ether, ServiceState.Active);
        assertAssigned(taskNo(6), serviceId);
        assertEq(tasks.task(taskNo(6)).price, 10 ether);
        attempt(taskNo(6), true);
        assertAssigned(taskNo(7), serviceId);
        vm.revertToState(snapshot);
    }

    /// @dev Nor does it hold up a verdict or the money, whatever made the service free.
    function test_attack_aBadPolicyHoldsUpNoAttemptThatEnds() public {
        for (uint8 how = 0; how <= uint8(type(Freed).max); ++how) {
            for (uint8 way = 1; way <= uint8(type(Way).max); ++way) {
                uint256 snapshot = vm.snapshotState();
                TaskStubPolicy stub = new TaskStubPolicy();
                _use(stub);
                ServiceId serviceId = _busy(Freed(how));
                post(alice, 40 ether);
                stub.tell(Way(way), 0);
                _free(Freed(how), serviceId);
                TaskId next = services.service(serviceId).taskId;
                assertTrue(next != NO_TASK, "the service has work");
                assertEq(tasks.task(next).price, 10 ether);
                vm.revertToState(snapshot);
            }
        }
    }

    /// @dev Whatever gas the transaction has, the policy is not made to fail by it.
    function test_attack_theCallerChoosesByItsGas() public {
        SlowPolicy slow = new SlowPolicy();
        _use(slow);
        ServiceId serviceId = offer(robot1, 10 ether);
        TaskId running = post(alice, 10 ether);
        post(alice, 40 ether);
        TaskId chosen = post(alice, 40 ether);
        bool once = false;
        for (uint256 gas = 400_000; gas < 1_400_000; gas += 2000) {
            uint256 snapshot = vm.snapshotState();
            vm.prank(robot1);
            try tasks.abandonTask{gas: gas}(running, 1) {
                once = true;
                assertAssigned(chosen, serviceId);
            } catch {
                assertFalse(once, "more gas was too little");
            }
            vm.revertToState(snapshot);
        }
        assertTrue(once);
    }

    /// @dev Whatever the policy answers, the service has a task that fits, at its own price.
    function testFuzz_whateverThePolicySaysTheTaskFits(uint256 chosen, bool near) public {
        TaskStubPolicy stub = new TaskStubPolicy();
        ServiceId serviceId = _queue(stub);
        if (near) chosen = bound(chosen, 0, 8);
        stub.tell(Way.Answers, chosen);
        update(serviceId, 10 ether, ServiceState.Active);
        TaskId taskId = services.service(serviceId).taskId;
        assertEq(tasks.task(taskId).price, 10 ether);
        if (chosen == 7) assertEq(taskId, 7, "the policy's choice");
        else assertEq(taskId, 6, "the oldest");
    }

    // -- and tasks that name it ---------------------------------------------------------------------------

    function _hire(ServiceId serviceId, address provider) private returns (TaskId) {
        TaskRequest memory r = request(50 ether);
        (r.serviceId, r.provider) = (serviceId.pack(), provider);
        vm.prank(alice);
        return tasks.registerTask(r);
    }

    function test_aTaskThatNamesTheServiceGoesFirstIfItIsOlderThanTheChosenOne() public {
        for (uint256 i = 0; i < 2; ++i) {
            uint256 snapshot = vm.snapshotState();
            TaskStubPolicy stub = new TaskStubPolicy();
            _use(stub);
            ServiceId serviceId = offer(robot1, 10 ether);
            update(serviceId, 10 ether, ServiceState.Paused);
            post(alice, 40 ether);
            TaskId naming = i == 0 ? _hire(serviceId, address(0)) : _hire(NO_SERVICE, robot1);
            TaskId chosen = post(alice, 50 ether);
            stub.tell(Way.Answers, TaskId.unwrap(chosen));
            update(serviceId, 10 ether, ServiceState.Active);
            assertAssigned(naming, serviceId);
            attempt(naming, true);
            assertAssigned(chosen, serviceId);
            vm.revertToState(snapshot);
        }
    }

    function test_theChosenTaskGoesFirstIfItIsOlderThanOneThatNamesTheService() public {
        TaskStubPolicy stub = new TaskStubPolicy();
        _use(stub);
        ServiceId serviceId = offer(robot1, 10 ether);
        update(serviceId, 10 ether, ServiceState.Paused);
        post(alice, 40 ether);
        TaskId chosen = post(alice, 50 ether);
        TaskId naming = _hire(serviceId, address(0));
        stub.tell(Way.Answers, TaskId.unwrap(chosen));
        update(serviceId, 10 ether, ServiceState.Active);
        assertAssigned(chosen, serviceId);
        stub.tell(Way.Answers, TaskId.unwrap(post(alice, 60 ether)));
        attempt(chosen, true);
        assertAssigned(taskNo(1) < naming ? naming : taskNo(1), serviceId);
    }

    // -- who is asked -------------------------------------------------------------------------------------

    function _expectQuestions(IMatchingPolicy policy_, uint64 number) private {
        vm.expectCall(address(policy_), abi.encodeWithSelector(IMatchingPolicy.taskFor.selector), number);
    }

    function test_nobodyIsAskedWhereNoTaskWaitsThatTheServiceCanDo() public {
        _expectQuestions(_lowestPrice, 0);
        _use(_lowestPrice);
        ServiceId serviceId = offer(robot1, 10 ether);
        attempt(post(alice, 40 ether), true);
        post(alice, 5 ether);
        update(serviceId, 20 ether, ServiceState.Active);
        attempt(post(alice, 40 ether), true);
        _hire(serviceId, address(0));
        TaskId last = _hire(serviceId, address(0));
        attempt(services.service(serviceId).taskId, true);
        assertAssigned(last, serviceId);
    }

    function test_firstCome_isNotAsked() public {
        _expectQuestions(policy, 0);
        offer(robot1, 10 ether);
        TaskId taskId = post(alice, 40 ether);
        post(alice, 40 ether);
        post(alice, 40 ether);
        attempt(taskId, true);
        attempt(taskNo(2), false);
        offer(robot2, 10 ether);
    }

    function test_aPolicyAfterFirstComeIsAskedAtOnce() public {
        for (uint256 i = 0; i < 4; ++i) {
            post(alice, 40 ether);
        }
        _use(new StubPolicy(Way.Answers, 3));
        assertAssigned(taskNo(3), offer(robot1, 10 ether));
        _use(policy);
        assertAssigned(taskNo(1), offer(robot2, 10 ether));
    }

    function test_whatThePolicySaysCanBeAsked() public {
        StubPolicy stub = new StubPolicy(Way.Answers, 7);
        _use(stub);
        ITaskQueues queues = tasks.queues();
        assertEq(queues.serviceFor(cleaning(), 0, NOBODY), 7);
        stub.tell(Way.Reverts, 7);
        assertEq(queues.serviceFor(cleaning(), 0, NOBODY), type(uint256).max);
    }

    // -- levels -------------------------------------------------------------------------------------------

    function test_oddPricesAreRoundedUpToThreeDigits() public {
        ServiceId odd = offer(robot1, 99.71 ether);
        assertState(post(alice, 99.75 ether), TaskState.Open);
        vm.prank(alice);
        tasks.cancelTask(taskNo(1));
        TaskId taskId = post(alice, 99.8 ether);
        assertAssigned(taskId, odd);
        assertEq(tasks.task(taskId).price, 99.71 ether, "what it asked");
    }

    function testFuzz_aServiceThatIsFoundIsAffordable(uint256 price, uint256 reward, uint256 unit)
        public
        pure
    {
        unit = 10 ** bound(unit, 0, 9);
        uint256 max = Units.max(unit);
        price = bound(price, 0, max / unit) * unit;
        reward = bound(reward, 0, type(uint96).max);
        uint64 level = Units.levelOf(reward, unit);
        bool found = Units.levelFor(price, unit) <= level;
        if (found) assertLe(price, reward);
        bool comparable = price > 1000 * unit && price < max / 2;
        if (comparable && reward > price + price / 100) assertTrue(found, "within a hundredth");
        assertGe(priceOf(Units.levelFor(price, unit), unit), price);
        assertEq(Units.levelOf(Math.min(priceOf(level, unit), max), unit), level);
        assertLt(Units.levelFor(price, unit), 1 << 14, "few levels");
    }

    // -- all of them --------------------------------------------------------------------------------------

    function test_aNewPolicyHoldsFromTheNextTaskOnAndMovesNoLiveOne() public {
        ServiceId dear = offer(robot1, 90 ether);
        ServiceId cheap = offer(robot2, 10 ether);
        ServiceId dearest = offer(robot3, 95 ether);
        TaskId running = post(alice, 100 ether);
        TaskId waiting = post(bob, 5 ether);
        _use(_lowestPrice);
        assertAssigned(running, dear);
        assertState(waiting, TaskState.Open);
        assertAssigned(post(alice, 100 ether), cheap);
        _use(policy);
        attempt(running, true);
        assertAssigned(post(alice, 100 ether), dearest);
        // The freed service still takes the oldest task that pays for it.
        update(dear, 5 ether, ServiceState.Active);
        assertAssigned(waiting, dear);
    }

    /// @dev Whatever was registered, priced, paused and judged before, each policy finds what a list would.
    /// forge-config: default.fuzz.runs = 48
    function testFuzz_policiesChooseAsASearchOfAllServicesWould(uint256 seed) public {
        for (uint256 i = 0; i < 25; ++i) {
            seed = uint256(keccak256(abi.encode(seed)));
            uint256 count = services.serviceCount();
            ServiceId serviceId = serviceNo(count == 0 ? 0 : 1 + (seed >> 16) % count);
            uint256 choice = seed % 4;
            if (choice == 0 || count < 3) {
                offer(address(uint160(1000 + services.serviceCount())), _price(seed));
            } else if (choice == 1 && services.service(serviceId).taskId == NO_TASK) {
                update(serviceId, _price(seed), ServiceState(1 + (seed >> 32) % 2));
            } else {
                TaskId taskId = post(alice, 5 ether);
                if (state(taskId) == TaskState.Assigned) attempt(taskId, seed & (1 << 100) == 0);
                if (state(taskId) == TaskState.Assigned) attempt(taskId, true);
                if (state(taskId) == TaskState.Open) {
                    vm.prank(alice);
                    tasks.cancelTask(taskId);
                }
            }
            uint256 reward = ((seed >> 64) % 6) * 1 ether;
            assertEq(
                services.bestIdle(cleaning(), reward, NOBODY, Choice.Oldest),
                _search(reward, _longer),
                "longest"
            );
            assertEq(
                services.bestIdle(cleaning(), reward, NOBODY, Choice.Cheapest),
                _search(reward, _cheaper),
                "cheapest"
            );
            assertEq(
                services.bestIdle(cleaning(), reward, NOBODY, Choice.MostReputable),
                _search(reward, _better),
                "reputable"
            );
        }
    }

    function _price(uint256 seed) private pure returns (uint256) {
        return ((seed >> 48) % 5) * 1 ether;
    }

    function _search(uint256 reward, function(Service memory, Service memory) pure returns (bool) isBetter)
        private
        view
        returns (ServiceId best)
    {
        for (ServiceId serviceId = serviceNo(1); exists(serviceId); serviceId = following(serviceId)) {
            Service memory s = services.service(serviceId);
            if (s.place == 0 || s.price > reward) continue;
            if (best == NO_SERVICE || isBetter(s, services.service(best))) best = serviceId;
        }
    }

    function _longer(Service memory a, Service memory b) private pure returns (bool) {
        return a.place < b.place;
    }

    function _cheaper(Service memory a, Service memory b) private pure returns (bool) {
        if (a.price != b.price) return a.price < b.price;
        return _grade(a) != _grade(b) ? _grade(a) > _grade(b) : _longer(a, b);
    }

    function _better(Service memory a, Service memory b) private pure returns (bool) {
        if (_grade(a) != _grade(b)) return _grade(a) > _grade(b);
        return a.price != b.price ? a.price < b.price : _longer(a, b);
    }

    function _grade(Service memory s) private pure returns (uint256) {
        return s.reputation / 8;
    }
}
