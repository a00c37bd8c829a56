// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {Test} from "forge-std/Test.sol";
import {IECoin} from "../src/IECoin.sol";
import {Organization} from "../src/Organization.sol";
import {ServiceManager} from "../src/ServiceManager.sol";
import {TaskManager} from "../src/TaskManager.sol";
import {Review, Terms} from "../src/interfaces/IOrganization.sol";
import {ServiceState} from "../src/interfaces/IServiceManager.sol";
import {Silence, Task, TaskRequest, TaskState, Verdict} from "../src/interfaces/ITaskManager.sol";
import {FirstComeFirstServed} from "../src/policies/FirstComeFirstServed.sol";

/// @notice An organization with its contracts, two humans who post tasks and three robots who do them.
abstract contract Fixture is Test {
    bytes32 internal constant CLEANING = "waste_disposal";
    bytes32 internal constant CHARGING = "battery_charging";
    bytes32 internal constant RULES = keccak256("rules");
    bytes32 internal constant PROOF = keccak256("recording");
    bytes32 internal constant REPORT = keccak256("report");
    string internal constant URI = "https://store/recording.mcap";
    uint32 internal constant WINDOW = 1 hours;
    uint32 internal constant AUDIT_WINDOW = 2 hours;
    uint8 internal constant ATTEMPTS = 3;
    /// @dev The bond that a provider agrees to who takes any.
    uint256 internal constant NO_LIMIT = type(uint256).max;

    address internal immutable admin = makeAddr("admin");
    address internal immutable oracle = makeAddr("oracle");
    address internal immutable auditor = makeAddr("auditor");
    address internal immutable alice = makeAddr("alice");
    address internal immutable bob = makeAddr("bob");
    address internal immutable robot1 = makeAddr("robot1");
    address internal immutable robot2 = makeAddr("robot2");
    address internal immutable robot3 = makeAddr("robot3");
    address internal immutable stranger = makeAddr("stranger");

    IECoin internal coin;
    FirstComeFirstServed internal policy;
    Organization internal organization;
    ServiceManager internal services;
    TaskManager internal tasks;

    function setUp() public virtual {
        address[] memory holders = new address[](4);
        uint256[] memory amounts = new uint256[](4);
        // The organization comes after the coin.
        address organization_ = vm.computeCreateAddress(address(this), vm.getNonce(address(this)) + 2);
        (holders[0], holders[1], holders[2], holders[3]) = (organization_, alice, bob, robot1);
        for (uint256 i = 0; i < 4; ++i) {
            amounts[i] = 2000 ether;
        }
        coin = new IECoin(holders, amounts);
        policy = new FirstComeFirstServed();
        found(coin);
        for (uint256 i = 1; i < 4; ++i) {
            vm.prank(holders[i]);
            coin.approve(address(tasks), type(uint256).max);
        }
        vm.warp(1_700_000_000);
    }

    /// @dev An organization that pays in `token`: all variables but `coin` and `policy`.
    function found(IERC20 token) internal {
        uint64 nonce = vm.getNonce(address(this));
        organization = Organization(vm.computeCreateAddress(address(this), nonce));
        services = ServiceManager(vm.computeCreateAddress(address(this), nonce + 1));
        tasks = TaskManager(vm.computeCreateAddress(address(this), nonce + 2));
        new Organization(token, services, tasks, policy, admin, 0, Terms(0, 0, 0));
        new ServiceManager(organization, tasks);
        new TaskManager(organization, services);

        vm.startPrank(admin);
        organization.grantRole(organization.ORACLE_ROLE(), oracle);
        organization.grantRole(organization.AUDITOR_ROLE(), auditor);
        organization.grantRole(organization.OPERATOR_ROLE(), admin);
        organization.grantRole(organization.TREASURER_ROLE(), admin);
        organization.setAudit(CLEANING, AUDIT_WINDOW, Silence.Executor);
        organization.setAudit(CHARGING, AUDIT_WINDOW, Silence.Creator);
        organization.allowKind(CLEANING, Review.Oracle, RULES);
        organization.allowKind(CHARGING, Review.Oracle, RULES);
        vm.stopPrank();
    }

    function setTerms(uint96 bond, uint96 penalty, uint8 maxFailures) internal {
        vm.prank(admin);
        organization.setTerms(Terms(bond, penalty, maxFailures));
    }

    function update(uint256 serviceId, uint256 price, ServiceState next) internal {
        vm.prank(services.providerOf(serviceId));
        services.updateService(serviceId, price, next);
    }

    /// @dev One attempt at the task from proof to verdict.
    function attempt(uint256 taskId, bool accepted) internal {
        submit(taskId);
        judge(taskId, accepted);
    }

    function request(uint256 reward) internal pure returns (TaskRequest memory) {
        return TaskRequest(CLEANING, reward, WINDOW, WINDOW, ATTEMPTS, 0, 0, address(0), "{}");
    }

    function post(address creator, uint256 reward) internal returns (uint256 taskId) {
        vm.prank(creator);
        return tasks.registerTask(request(reward));
    }

    function offer(address provider, uint256 price) internal returns (uint256 serviceId) {
        vm.prank(provider);
        return services.registerService(CLEANING, price, NO_LIMIT, true, "");
    }

    function submit(uint256 taskId) internal {
        Task memory t = tasks.task(taskId);
        vm.prank(services.service(t.serviceId).provider);
        tasks.submitProof(taskId, t.attempt, PROOF, URI);
    }

    /// @dev The oracle accepts at the full price, or rejects.
    function judge(uint256 taskId, bool accepted) internal {
        Task memory t = tasks.task(taskId);
        (Verdict verdict, uint256 amount) =
            accepted ? (Verdict.Accepted, uint256(t.price)) : (Verdict.Rejected, 0);
        vm.prank(oracle);
        tasks.postVerdict(taskId, t.attempt, t.proofHash, verdict, amount, REPORT, "report", "because");
    }

    function judgeAs(address who, uint256 taskId, Verdict verdict, uint256 amount) internal {
        Task memory t = tasks.task(taskId);
        vm.prank(who);
        tasks.postVerdict(taskId, t.attempt, t.proofHash, verdict, amount, REPORT, "report", "because");
    }

    function state(uint256 taskId) internal view returns (TaskState) {
        return tasks.task(taskId).state;
    }

    function assertState(uint256 taskId, TaskState expected) internal view {
        assertEq(uint8(state(taskId)), uint8(expected), "task state");
    }

    function assertAssigned(uint256 taskId, uint256 serviceId) internal view {
        assertState(taskId, TaskState.Assigned);
        assertEq(tasks.task(taskId).serviceId, serviceId, "the task's service");
        assertEq(services.service(serviceId).taskId, taskId, "the service's task");
    }
}
