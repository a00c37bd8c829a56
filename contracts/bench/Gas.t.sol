// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Strings} from "@openzeppelin/contracts/utils/Strings.sol";
import {IECoin} from "../src/IECoin.sol";
import {ServiceManager} from "../src/ServiceManager.sol";
import {TaskManager} from "../src/TaskManager.sol";
import {Fault, Ruling, TaskRequest} from "../src/interfaces/ITaskManager.sol";
import {Units} from "../src/libraries/Units.sol";
import {Finding} from "../src/interfaces/IJudge.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {RoleJudge} from "../src/judges/RoleJudge.sol";
import {ORACLE_ROLE} from "../src/types/Roles.sol";
import {Committee} from "../test/Committee.sol";
import {Fixture} from "../test/Fixture.sol";
import {Instances} from "../test/Instances.sol";

/// @notice An oracle that accepts every first attempt.
contract Judge {
    RoleJudge private immutable _judge;

    constructor(RoleJudge judge) {
        _judge = judge;
    }

    function accept(TaskManager tasks, TaskId taskId) external {
        uint96 price = tasks.task(taskId).price;
        _judge.rule(Finding(taskId, 1, "proof", 0, 0, Ruling.Accepted, Fault.Nobody, price, ""), "");
    }
}

/// @notice Posts tasks.
contract Customer {
    TaskManager private immutable _tasks;

    constructor(IECoin coin, TaskManager tasks) {
        _tasks = tasks;
        coin.approve(address(tasks), type(uint256).max);
    }

    function post(TaskRequest calldata request) external returns (TaskId) {
        return _tasks.registerTask(request);
    }
}

/// @notice Does many tasks from beginning to end in one transaction, as provider, and gives the customer its money back.
contract Everyone {
    IECoin private immutable _coin;
    TaskManager private immutable _tasks;
    Customer public immutable customer;

    constructor(IECoin coin, TaskManager tasks) {
        (_coin, _tasks, customer) = (coin, tasks, new Customer(coin, tasks));
        coin.approve(address(tasks), type(uint256).max);
    }

    function offer(ServiceManager services, bytes32 kind, uint256 price, uint256 number) external {
        for (uint256 i = 0; i < number; ++i) {
            services.registerService(kind, price, type(uint256).max, true, "");
        }
    }

    function work(Judge judge, TaskRequest calldata request, uint256 number) external {
        for (uint256 i = 0; i < number; ++i) {
            TaskId taskId = customer.post(request);
            _tasks.submitProof(taskId, 1, "proof", "");
            uint256 price = _tasks.task(taskId).price;
            judge.accept(_tasks, taskId);
            _coin.transfer(address(customer), price);
        }
    }
}

/// @notice What transactions cost, intrinsic gas and refunds included (the profile `bench` isolates each call).
/// `bench/contracts.py` reads the figures.
contract GasBench is Fixture {
    uint256 private constant SERVICES = 1000;
    uint96 private constant PRICE = 80 ether;
    uint256 private constant REWARD = 100 ether;

    /// @dev As long as real ones.
    string private constant PARAMS = '{"item_id":"item1","x_m":4.6,"y_m":1.2}';
    string private constant PROOF_URI =
        "file:///srv/rodeo/store/aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa.mcap";

    function test_waitingTask() public {
        _register();
        _cancel(taskNo(1));
        // The first task and the first service of a kind pay for what the kind needs once.
        _register();
        _figure("gas_register_queued", _used());
        _cancel(taskNo(2));
        _figure("gas_cancel", _used());
        offer(robot1, PRICE);
        offer(robot1, PRICE);
        _figure("gas_register_service", _used());
    }

    /// @dev Register with matching, proof, verdict with settlement; the first of a creator, the 2nd, the 500th
    /// and the 10,000th task.
    function test_lifecycle() public {
        Everyone everyone = new Everyone(coin, tasks);
        Judge judge = new Judge(oracleJudge);
        bytes32 role = ORACLE_ROLE;
        vm.prank(admin);
        organization.grantRole(role, address(judge));
        // Nonzero terms, as new organizations have them.
        setTerms(1 ether, 0.25 ether, 3);
        vm.prank(admin);
        organization.vouchFor(address(everyone), true);
        vm.prank(bob);
        coin.transfer(address(everyone), SERVICES * 1 ether + 1);
        address customer = address(everyone.customer());
        vm.prank(bob);
        coin.transfer(customer, REWARD);
        // More than a provider may have: many would cost the same, and could not be driven from one contract.
        bytes32 live = keccak256(abi.encode(everyone, uint256(4)));
        for (uint256 i = 0; i < SERVICES; i += 8) {
            everyone.offer(services, CLEANING, PRICE, 8);
            vm.store(address(services), live, 0);
        }

        // The first task of a creator makes the word of its conditions, which the others share.
        _lifecycle(address(everyone));
        _lifecycle(address(everyone));
        everyone.work(judge, request(REWARD), 497);
        _lifecycle(address(everyone));
        for (uint256 i = 0; i < 18; ++i) {
            everyone.work(judge, request(REWARD), 500);
        }
        everyone.work(judge, request(REWARD), 499);
        _lifecycle(address(everyone));
        _spam();
        _lifecycle(address(everyone), "gas_lifecycle_spam");
    }

    /// @dev As much as ten identities with bonds get for 10M gas: services that nobody pays for, at the prices that
    /// make the way to the others' services longest.
    function _spam() private {
        uint64 level = Units.levelFor(PRICE, 1 gwei);
        uint256 gas = 0;
        for (uint256 i = 0; i < 80 && gas < 10_000_000; ++i) {
            address identity = address(uint160(0xbad00 + i / 8));
            if (i % 8 == 0) {
                vm.prank(bob);
                coin.transfer(identity, 8 ether);
                vm.prank(identity);
                coin.approve(address(tasks), type(uint256).max);
            }
            uint64 near = i < 13 ? level ^ uint64(1 << i) : uint64(uint256(keccak256(abi.encode(i))) % 13_000);
            offer(identity, priceOf(near, 1 gwei));
            gas += _used();
        }
    }

    function _lifecycle(address provider) private {
        (uint256 register, uint256 proof, uint256 verdict) =
            _lifecycle(provider, string.concat("gas_lifecycle_", Strings.toString(tasks.taskCount() + 1)));
        _figure("gas_register", register);
        _figure("gas_proof", proof);
        _figure("gas_verdict", verdict);
    }

    function _lifecycle(address provider, string memory name)
        private
        returns (uint256 register, uint256 proof, uint256 verdict)
    {
        _register();
        register = _used();
        TaskId taskId = taskNo(tasks.taskCount());
        vm.prank(provider);
        tasks.submitProof(taskId, 1, PROOF, PROOF_URI);
        proof = _used();
        vm.prank(oracle);
        oracleJudge.rule(
            Finding(
                taskId, 1, PROOF, REPORT, RULES, Ruling.Accepted, Fault.Nobody, PRICE, "all checks passed"
            ),
            PROOF_URI
        );
        verdict = _used();
        _figure(name, register + proof + verdict);
    }

    function _register() private {
        TaskRequest memory r = request(REWARD);
        r.params = PARAMS;
        vm.prank(alice);
        tasks.registerTask(r);
    }

    function _cancel(TaskId taskId) private {
        vm.prank(alice);
        tasks.cancelTask(taskId);
    }

    function _used() private view returns (uint256) {
        return vm.lastCallGas().gasTotalUsed;
    }

    function _figure(string memory name, uint256 gas) private {
        vm.snapshotValue("contracts", name, gas);
    }
}

/// @notice What a verdict costs that a committee gives: three votes of five judges.
contract QuorumGasBench is Committee {
    function test_quorum() public {
        // The contract holds bonds, as in new organizations. An empty one would give back 4,800 gas with its last token.
        setTerms(1 ether, 0.25 ether, 3);
        for (uint256 i = 0; i < 3; ++i) {
            offer(robot1, 80 ether); // the line is never empty
        }
        for (uint256 i = 0; i < 4; ++i) {
            TaskId taskId = post(alice, 100 ether);
            submit(taskId);
            Finding memory vote = accepting(taskId);
            vote.reason = "all checks passed";
            bytes memory votes = signatures(vote, VOTES);
            vm.prank(stranger);
            committee.postVotes(
                vote,
                "file:///srv/rodeo/store/aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa.json",
                votes
            );
        }
        // The fourth, when everybody's balance, service and line have their words.
        vm.snapshotValue("contracts", "gas_verdict_quorum_3_of_5", vm.lastCallGas().gasTotalUsed);
    }
}

/// @notice What a dispute costs: the challenge, four votes of seven, and the payment.
contract DisputeGasBench is Instances {
    function setUp() public override {
        super.setUp();
        // Without a limit of failures, which the same service here would reach.
        setTerms(1 ether, 0.25 ether, 0);
    }

    function test_dispute() public {
        uint256 used;
        for (uint256 i = 0; i < 4; ++i) {
            TaskId taskId = ruled(Ruling.Accepted);
            challenge(alice, taskId);
            used = vm.lastCallGas().gasTotalUsed;
            decideSecond(taskId, Ruling.Rejected);
            used += vm.lastCallGas().gasTotalUsed;
            skip(CHALLENGE + 1);
            tasks.conclude(taskId);
            used += vm.lastCallGas().gasTotalUsed;
            disputes.settle(taskId, 1);
            used += vm.lastCallGas().gasTotalUsed;
        }
        vm.snapshotValue("contracts", "gas_dispute", used);
    }

    function test_unchallenged() public {
        uint256 used;
        for (uint256 i = 0; i < 4; ++i) {
            TaskId taskId = ruled(Ruling.Accepted);
            used = vm.lastCallGas().gasTotalUsed;
            skip(CHALLENGE + 1);
            tasks.conclude(taskId);
            used += vm.lastCallGas().gasTotalUsed;
        }
        vm.snapshotValue("contracts", "gas_verdict_with_window", used);
    }
}
