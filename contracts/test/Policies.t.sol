// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";
import {IMatchingPolicy} from "../src/interfaces/IMatchingPolicy.sol";
import {Service, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {ITaskManager, TaskState} from "../src/interfaces/ITaskManager.sol";
import {Units} from "../src/libraries/Units.sol";
import {HighestReputation} from "../src/policies/HighestReputation.sol";
import {LowestPrice} from "../src/policies/LowestPrice.sol";
import {SecondPrice} from "../src/policies/SecondPrice.sol";
import {NO_SERVICE, ServiceId} from "../src/types/ServiceId.sol";
import {NO_TASK, TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";

contract PolicyTest is Fixture {
    IMatchingPolicy private _lowestPrice;
    IMatchingPolicy private _highestReputation;

    function setUp() public override {
        super.setUp();
        _lowestPrice = new LowestPrice();
        _highestReputation = new HighestReputation();
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
        attempt(post(alice, 100 ether), false);
        attempt(taskNo(1), false);
        attempt(taskNo(1), false);
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

    // -- second price -------------------------------------------------------------------------------------

    function test_secondPrice_theCheapestIsPaidWhatTheNextOneAsks() public {
        _use(new SecondPrice());
        offer(robot1, 60 ether);
        ServiceId cheap = offer(robot2, 10 ether);
        offer(robot3, 90 ether);
        TaskId taskId = post(alice, 100 ether);
        assertAssigned(taskId, cheap);
        assertEq(tasks.task(taskId).price, 60 ether);
        uint256 before = coin.balanceOf(alice);
        attempt(taskId, true);
        assertEq(coin.balanceOf(robot2), 60 ether);
        assertEq(coin.balanceOf(alice) - before, 40 ether, "the surplus goes back");
    }

    function test_secondPrice_equalPricesArePaidAsAsked() public {
        _use(new SecondPrice());
        offer(robot1, 60 ether);
        offer(robot2, 60 ether);
        offer(robot3, 90 ether);
        assertEq(tasks.task(post(alice, 100 ether)).price, 60 ether);
        assertEq(tasks.task(post(alice, 100 ether)).price, 90 ether);
    }

    function test_secondPrice_isAtMostTheReward() public {
        _use(new SecondPrice());
        offer(robot1, 10 ether);
        offer(robot2, 90 ether);
        assertEq(tasks.task(post(alice, 50 ether)).price, 50 ether);
        update(serviceNo(2), 20 ether, ServiceState.Active);
        assertEq(tasks.task(post(alice, 100 ether)).price, 100 ether, "nobody else waits");
        assertEq(services.secondPrice(CLEANING), services.secondPrice("nothing"), "the greatest price");
    }

    function test_secondPrice_whoBecomesFreeIsPaidItsOwnPrice() public {
        _use(new SecondPrice());
        TaskId taskId = post(alice, 100 ether);
        offer(robot1, 10 ether);
        assertEq(tasks.task(taskId).price, 10 ether);
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
        assertGe(Units.priceOf(Units.levelFor(price, unit), unit), price);
        assertEq(Units.levelOf(Math.min(Units.priceOf(level, unit), max), unit), level);
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
            assertEq(services.longestIdle(CLEANING, reward), _search(reward, _longer), "longest");
            assertEq(services.cheapestIdle(CLEANING, reward), _search(reward, _cheaper), "cheapest");
            assertEq(services.mostReputableIdle(CLEANING, reward), _search(reward, _better), "reputable");
            assertEq(services.secondPrice(CLEANING), _secondPrice(), "second price");
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

    function _secondPrice() private view returns (uint256 second) {
        second = Units.max(1 gwei);
        ServiceId cheapest = services.cheapestIdle(CLEANING, Units.max(1 gwei));
        for (ServiceId serviceId = serviceNo(1); exists(serviceId); serviceId = following(serviceId)) {
            Service memory s = services.service(serviceId);
            if (s.place != 0 && serviceId != cheapest && s.price < second) second = s.price;
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
