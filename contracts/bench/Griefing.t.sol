// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";
import {Service, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {IMatchingPolicy} from "../src/interfaces/IMatchingPolicy.sol";
import {Ruling, Task, TaskRequest, TaskState} from "../src/interfaces/ITaskManager.sol";
import {HighestReputation} from "../src/policies/HighestReputation.sol";
import {LowestPrice} from "../src/policies/LowestPrice.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {NO_TASK, TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "../test/Fixture.sol";

/// @notice What strangers can do against one honest robot in a day, with 1,000 tokens locked and 10 EUR: 96 tasks of three
/// attempts, posted every quarter of an hour by two creators, under the terms of new organizations (20/5/3). Each test takes
/// the worst of a grid. `bench/contracts.py` reads the figures. Accounts that the attacker has proven before are told apart:
/// each costs work that an oracle accepts, which 10 EUR do not pay.
/// @dev Time comes from the machine: the compiler takes `block.timestamp` for the same in all of a transaction.
contract GriefingBench is Fixture {
    /// @dev What an account of the attacker does with a task.
    enum Way {
        GiveBack,
        GiveBackLate,
        Miss,
        GiveUp,
        Garbage,
        Expire,
        Name,
        Mixed
    }

    /// @param accounts of the attacker
    /// @param each services of an account
    /// @param renews an account whose bond is used up or rests long is replaced, if its money has come back
    /// @param proven each account was proven before the day
    struct Point {
        uint256 accounts;
        uint256 each;
        bool renews;
        Way way;
        bool proven;
    }

    /// @param failed tasks that failed
    /// @param delay in minutes, of 95 of 100 tasks at most, from posting to the start of the honest robot
    /// @param income the honest robot's, of what it has without an attacker, in thousandths
    /// @param gas of the dearest transaction with a match
    struct Damage {
        uint256 failed;
        uint256 delay;
        uint256 income;
        uint256 gas;
    }

    uint256 private constant TASKS = 96;
    uint256 private constant PERIOD = 15 minutes;
    /// @dev What the honest robot needs for a task.
    uint256 private constant WORK = 10 minutes;
    uint256 private constant STEP = 1 minutes;
    uint256 private constant LOCKED = 1000 ether;
    uint160 private constant ATTACKER = 0xbad0000;
    uint96 private constant BOND = 20 ether;
    uint96 private constant PENALTY = 5 ether;
    uint256 private constant PRICE = 30 ether;
    uint256 private constant REWARD = 40 ether;

    /// @dev EUR in millionths. One ETH is 3,700 EUR and gas costs 0.01 gwei, as on Arbitrum One; a token is worth 1 EUR, so
    /// that a penalty costs 5 EUR.
    uint256 private constant BUDGET = 10_000_000;
    uint256 private constant EUR_PER_ETH = 3700;
    uint256 private constant GWEI_PER_100_GAS = 1;
    uint256 private constant EUR_PER_TOKEN = 1;

    ServiceId private _honest;
    uint256 private _started;
    TaskId private _at;
    /// @dev Since when a task is at an account of the attacker, by attempt.
    mapping(TaskId taskId => mapping(uint8 attempt => uint256)) private _since;
    /// @dev The attacker keeps the task, and pays the penalty in the end.
    mapping(TaskId taskId => mapping(uint8 attempt => bool)) private _kept;
    mapping(TaskId taskId => uint256) private _posted;
    /// @dev The tasks of alice and bob, and of these and the attacker's those that are not over.
    TaskId[] private _due;
    TaskId[] private _live;
    uint256[] private _delays;
    uint256 private _spentGas;
    uint256 private _lostTokens;
    uint256 private _accounts;
    uint256 private _dearest;
    uint256 private _provingGas;
    /// @dev Tasks of the attacker that are not over.
    uint256 private _naming;
    Point private _point;

    /// @dev What a step has needed the next one uses again: a day's memory would cost more gas than there is.
    modifier frees() {
        uint256 free;
        assembly ("memory-safe") {
            free := mload(64)
        }
        _;
        assembly ("memory-safe") {
            mstore(64, free)
        }
    }

    function test_firstComeFirstServed() public {
        _grid("fcfs", policy);
    }

    function test_lowestPrice() public {
        _grid("lowest_price", LowestPrice(deployed("LowestPrice")));
    }

    function test_highestReputation() public {
        _grid("highest_reputation", HighestReputation(deployed("HighestReputation")));
    }

    /// @dev What stopped the market before services were proven: 41, 90, 96 and 84 to 96 tasks of 96 failed.
    function test_whatUsedToStopTheMarket() public {
        IMatchingPolicy lowest = LowestPrice(deployed("LowestPrice"));
        _figure("griefed_by_8_services", _failed(policy, Point(1, 8, false, Way.GiveBack, false)));
        _figure("griefed_by_48_services", _failed(policy, Point(6, 8, false, Way.GiveBack, false)));
        _figure("griefed_by_3_services", _failed(lowest, Point(1, 3, false, Way.GiveBack, false)));
        _figure("griefed_by_renewed_services", _failed(policy, Point(6, 8, true, Way.Miss, false)));
    }

    /// @dev What the transactions cost by which an account is proven.
    function test_proving() public {
        _point = Point(1, 1, false, Way.GiveBack, true);
        _begin(policy);
        _recruit();
        assertTrue(providers.isProven(address(ATTACKER)));
        _figure("proving_gas", _provingGas);
    }

    /// @dev Nobody is proven: when each of five honest newcomers has its first task.
    function _newcomers(string memory name, IMatchingPolicy policy_) private {
        uint256 worst = 0;
        for (uint256 way = 0; way <= uint256(type(Way).max); ++way) {
            uint256 snapshot = vm.snapshotState();
            _point = Point(50, 1, false, Way(way), false);
            uint256 hour = _firstTasks(policy_);
            vm.revertToState(snapshot);
            if (hour > worst) worst = hour;
        }
        _figure(string.concat("newcomer_first_task_h_", name), worst);
    }

    function _grid(string memory name, IMatchingPolicy policy_) private {
        uint256[2][5] memory sizes =
            [[uint256(1), 8], [uint256(3), 1], [uint256(6), 8], [uint256(25), 2], [uint256(50), 1]];
        Damage memory worst = Damage(0, 0, 1000, 0);
        for (uint256 way = 0; way <= uint256(type(Way).max); ++way) {
            // Who is not proven names nobody, however often.
            uint256 points = Way(way) == Way.Name ? 1 : 2 * sizes.length;
            for (uint256 i = 0; i < points; ++i) {
                uint256[2] memory size = sizes[i / 2];
                worst = _worse(worst, policy_, Point(size[0], size[1], i % 2 == 1, Way(way), false));
            }
        }
        worst.gas = Math.max(worst.gas, _provenGrid(name, policy_));
        _figure(string.concat("griefing_tasks_failed_", name), worst.failed);
        _figure(string.concat("griefing_delay_p95_min_", name), worst.delay);
        _figure(string.concat("griefing_honest_income_permille_", name), worst.income);
        _figure(string.concat("griefing_match_gas_max_", name), worst.gas);
        _newcomers(name, policy_);
    }

    /// @return The gas of the dearest match.
    function _provenGrid(string memory name, IMatchingPolicy policy_) private returns (uint256) {
        uint256[3] memory accounts = [uint256(2), 8, 50];
        Way[3] memory ways = [Way.GiveBack, Way.GiveUp, Way.Mixed];
        Damage memory worst = _worse(Damage(0, 0, 1000, 0), policy_, Point(2, 1, false, Way.Name, true));
        _figure(string.concat("named_delay_p95_min_", name), worst.delay);
        for (uint256 i = 0; i < accounts.length; ++i) {
            worst.failed = 0;
            for (uint256 j = 0; j < ways.length; ++j) {
                worst = _worse(worst, policy_, Point(accounts[i], 1, false, ways[j], true));
            }
            string memory number = vm.toString(accounts[i]);
            _figure(string.concat("griefed_by_", number, "_proven_", name), worst.failed);
        }
        return worst.gas;
    }

    function _failed(IMatchingPolicy policy_, Point memory point) private returns (uint256) {
        return _worse(Damage(0, 0, 1000, 0), policy_, point).failed;
    }

    /// @dev With one more day.
    function _worse(Damage memory a, IMatchingPolicy policy_, Point memory point)
        private
        returns (Damage memory)
    {
        uint256 snapshot = vm.snapshotState();
        Damage memory b = _day(policy_, point);
        vm.revertToState(snapshot);
        if (b.failed > a.failed) a.failed = b.failed;
        if (b.delay > a.delay) a.delay = b.delay;
        if (b.income < a.income) a.income = b.income;
        if (b.gas > a.gas) a.gas = b.gas;
        return a;
    }

    function _day(IMatchingPolicy policy_, Point memory point) private returns (Damage memory d) {
        _point = point;
        _begin(policy_);
        // An attacker that waits longer than the honest robot is served before it.
        _recruit();
        _honest = _offer(robot1, PRICE, true);
        uint256 before = coin.balanceOf(robot1);
        uint256 start = vm.getBlockTimestamp();
        for (uint256 minute = 0; minute < (TASKS + 8) * PERIOD / STEP; ++minute) {
            vm.warp(start + minute * STEP);
            if (minute % (PERIOD / STEP) == 0 && _due.length < TASKS) _post();
            _step();
        }
        for (uint256 i = 0; i < TASKS; ++i) {
            if (state(_due[i]) != TaskState.Settled) ++d.failed;
        }
        d.income = (coin.balanceOf(robot1) - before) * 1000 / (TASKS * PRICE);
        (d.delay, d.gas) = (_percentile95() / 1 minutes, _dearest);
    }

    function _begin(IMatchingPolicy policy_) private {
        setTerms(BOND, PENALTY, 3);
        vm.startPrank(admin);
        organization.setPolicy(policy_);
        organization.setWindows(CLEANING, windows(SHORTEST, 3 minutes), 1 ether);
        vm.stopPrank();
        deal(address(coin), alice, 1e6 ether);
        deal(address(coin), bob, 1e6 ether);
    }

    function _recruit() private frees {
        for (uint256 i = 0; i < _point.accounts; ++i) {
            _recruitOne();
        }
    }

    /// @dev Cheaper than the honest robot, so that it is chosen under LowestPrice, too.
    function _recruitOne() private {
        address account = address(uint160(ATTACKER + _accounts++));
        deal(address(coin), account, _point.each * BOND);
        vm.prank(account);
        coin.approve(address(tasks), type(uint256).max);
        if (_point.proven) _prove(account);
        for (uint256 i = _point.proven ? 1 : 0; i < _point.each && _point.way != Way.Name; ++i) {
            _offer(account, PRICE - 1 ether, _wayOf(account) != Way.Miss);
            _pay();
        }
    }

    /// @dev Three tasks of two puppets, who pay next to nothing for work that the oracle accepts. What that work costs is not
    /// counted, only its gas.
    function _prove(address account) private {
        vm.prank(account);
        ServiceId serviceId =
            services.registerService(CLEANING, 1 gwei, NO_LIMIT, _wayOf(account) != Way.Miss, "");
        _provingGas = vm.lastCallGas().gasTotalUsed;
        TaskRequest memory r = request(1 gwei);
        for (uint256 i = 0; i < 3; ++i) {
            address puppet = i == 0 ? alice : bob;
            vm.prank(puppet);
            TaskId taskId = tasks.registerTask(r);
            _provingGas += vm.lastCallGas().gasTotalUsed;
            submit(taskId);
            _provingGas += vm.lastCallGas().gasTotalUsed;
            judge(taskId, true);
        }
        update(serviceId, PRICE - 1 ether, _point.way == Way.Name ? ServiceState.Paused : ServiceState.Active);
        _provingGas += vm.lastCallGas().gasTotalUsed;
    }

    /// @dev With several ways at once, each account has its own.
    function _wayOf(address account) private view returns (Way) {
        if (_point.way != Way.Mixed) return _point.way;
        return Way((uint160(account) - ATTACKER) % uint256(Way.Name));
    }

    function _post() private frees {
        TaskId taskId = taskNo(tasks.taskCount() + 1);
        _posted[taskId] = vm.getBlockTimestamp();
        vm.prank(_due.length % 2 == 0 ? alice : bob);
        tasks.registerTask(request(REWARD));
        _measure();
        _due.push(taskId);
        _live.push(taskId);
    }

    /// @dev One minute: the honest robot, the attacker's accounts, and anybody who ends what is over.
    function _step() private frees {
        if (_point.way == Way.Name || _point.way == Way.Mixed) _nameHonest();
        for (uint256 i = 0; i < _live.length;) {
            TaskId taskId = _live[i];
            Task memory t = tasks.task(taskId);
            if (t.state == TaskState.Open) _meet(taskId);
            else if (t.state == TaskState.Assigned && t.serviceId == _honest) _work(taskId);
            else if (t.state == TaskState.Assigned) _attack(taskId, t);
            if (!_forget(i, t.state)) ++i;
        }
        if (vm.getBlockTimestamp() % 10 minutes < STEP) _return();
    }

    /// @dev Whether the task was over.
    function _forget(uint256 index, TaskState current) private returns (bool over) {
        over = current == TaskState.Settled || current == TaskState.Failed;
        if (!over) return false;
        if (_posted[_live[index]] == 0) --_naming;
        _live[index] = _live[_live.length - 1];
        _live.pop();
    }

    /// @dev The honest robot's bridge asks for a task that was overlooked.
    function _meet(TaskId taskId) private {
        Service memory s = services.service(_honest);
        if (s.place == 0) return;
        try tasks.matchTask(taskId, _honest) {
            _measure();
        } catch {}
    }

    function _work(TaskId taskId) private {
        if (_at != taskId) {
            (_at, _started) = (taskId, vm.getBlockTimestamp());
            if (_posted[taskId] != 0) _delays.push(vm.getBlockTimestamp() - _posted[taskId]);
        }
        if (vm.getBlockTimestamp() < _started + WORK) return;
        submit(taskId);
        bool real = _posted[taskId] != 0;
        judgeAs(oracle, taskId, real ? Ruling.Accepted : Ruling.Void, real ? PRICE : 0);
        _measure();
        _at = NO_TASK;
    }

    /// @dev A penalty is spent when the work is kept that it will cost: the attacker knows how much it has left.
    function _attack(TaskId taskId, Task memory t) private {
        address account = services.providerOf(t.serviceId);
        Way way = _wayOf(account);
        bool costs = (way == Way.GiveUp && !_point.proven) || way == Way.Garbage || way == Way.Expire;
        if (_since[taskId][t.attempt] == 0) {
            _since[taskId][t.attempt] = vm.getBlockTimestamp();
            _kept[taskId][t.attempt] = costs && _affords(PENALTY);
            if (_kept[taskId][t.attempt]) _lostTokens += PENALTY;
        }
        if (costs && !_kept[taskId][t.attempt]) way = Way.GiveBack;
        uint256 elapsed = vm.getBlockTimestamp() - _since[taskId][t.attempt];
        if (way == Way.GiveBack || (way == Way.GiveBackLate && elapsed >= 2 minutes)) {
            vm.prank(account);
            tasks.abandonTask(taskId, t.attempt);
            _pay();
        } else if (way == Way.GiveUp || way == Way.Garbage) {
            vm.prank(account);
            tasks.submitProof(taskId, t.attempt, PROOF, "");
            _pay();
            judgeAs(oracle, taskId, way == Way.GiveUp ? Ruling.GivenUp : Ruling.Rejected, 0);
        } else if (vm.getBlockTimestamp() > t.deadline || (!t.accepted && elapsed > 3 minutes)) {
            tasks.expireTask(taskId);
        } else {
            return;
        }
        _measure();
    }

    /// @dev Accounts that have rested come back; used-up ones are replaced, as far as the money goes.
    function _return() private {
        for (uint256 i = 1; i <= services.serviceCount() && _affords(0); ++i) {
            ServiceId serviceId = serviceNo(i);
            if (serviceId == _honest) continue;
            Service memory s = services.service(serviceId);
            if (s.state == ServiceState.Retired || s.taskId != NO_TASK || s.place != 0) continue;
            uint256 until = providers.asleepUntil(s.provider);
            bool over = s.state == ServiceState.Suspended || until > vm.getBlockTimestamp() + 2 hours;
            if (over && _point.renews && s.bond != 0) _renew(serviceId, s);
            else if (until == 0 && s.state == ServiceState.Active) _update(serviceId, s, ServiceState.Active);
        }
    }

    function _renew(ServiceId serviceId, Service memory s) private {
        _update(serviceId, s, ServiceState.Retired);
        if (coin.balanceOf(s.provider) >= BOND) _recruitOne();
    }

    function _update(ServiceId serviceId, Service memory s, ServiceState next) private {
        vm.prank(s.provider);
        try services.updateService(serviceId, s.price, next) {
            _pay();
        } catch {}
    }

    /// @dev A puppet posts tasks that name the honest robot, end void, and give their reward back.
    function _nameHonest() private {
        if (!_affords(0) || _naming == 3) return;
        address puppet = address(uint160(ATTACKER));
        deal(address(coin), puppet, LOCKED);
        TaskRequest memory r = request(REWARD);
        r.serviceId = _honest.pack();
        vm.prank(puppet);
        try tasks.registerTask(r) returns (TaskId taskId) {
            _live.push(taskId);
            ++_naming;
        } catch {}
        _pay();
    }

    /// @dev Hours until each of five honest newcomers has had a task; 25 if one had none in a day.
    function _firstTasks(IMatchingPolicy policy_) private returns (uint256 hour) {
        vm.prank(admin);
        organization.vouchFor(robot1, false);
        _begin(policy_);
        _recruit();
        uint256 start = vm.getBlockTimestamp();
        uint256 first = services.serviceCount() + 1;
        for (uint256 i = 0; i < 5; ++i) {
            address newcomer = address(uint160(0x600d0000 + i));
            deal(address(coin), newcomer, BOND);
            vm.prank(newcomer);
            coin.approve(address(tasks), type(uint256).max);
            _offer(newcomer, PRICE, true);
        }
        uint256 had = 0;
        for (uint256 minute = 0; minute < 1440; ++minute) {
            vm.warp(start + minute * STEP);
            if (minute % 15 == 0) _post();
            had |= _newcomersStep(first);
            if (had == 31) return (vm.getBlockTimestamp() - start + 1 hours - 1) / 1 hours;
        }
        return 25;
    }

    /// @dev The same minute; newcomers work at once. Returns who had a task, one bit each.
    function _newcomersStep(uint256 first) private returns (uint256 had) {
        for (uint256 i = 0; i < _live.length;) {
            TaskId taskId = _live[i];
            Task memory t = tasks.task(taskId);
            uint256 number = ServiceId.unwrap(t.serviceId);
            bool honest = number >= first && number < first + 5;
            if (t.state == TaskState.Assigned && honest) {
                had |= 1 << (number - first);
                attempt(taskId, true);
            } else if (t.state == TaskState.Assigned) {
                _attack(taskId, t);
            }
            if (!_forget(i, t.state)) ++i;
        }
        if (vm.getBlockTimestamp() % 10 minutes < STEP) _return();
    }

    function _offer(address provider, uint256 price, bool autoAccept) private returns (ServiceId) {
        vm.prank(provider);
        return services.registerService(CLEANING, price, NO_LIMIT, autoAccept, "");
    }

    /// @dev The attacker's last transaction.
    function _pay() private {
        _spentGas += vm.lastCallGas().gasTotalUsed;
    }

    /// @dev With what it has spent today.
    function _affords(uint256 penalty) private view returns (bool) {
        uint256 gas = _spentGas * GWEI_PER_100_GAS * EUR_PER_ETH / 100 / 1000;
        return gas + (_lostTokens + penalty) * EUR_PER_TOKEN / 1e12 <= BUDGET;
    }

    /// @dev The last transaction had a match.
    function _measure() private {
        uint256 gas = vm.lastCallGas().gasTotalUsed;
        if (gas > _dearest) _dearest = gas;
    }

    function _percentile95() private returns (uint256) {
        uint256[] memory sorted = vm.sort(_delays);
        return sorted.length == 0 ? 1 days : sorted[sorted.length * 95 / 100];
    }

    function _figure(string memory name, uint256 value) private {
        vm.snapshotValue("contracts", name, value);
    }
}
