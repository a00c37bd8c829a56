// SPDX-License-Identifier: MIT
pragma solidity ^0.8.28;

import {
    AccessControlDefaultAdminRules
} from "@openzeppelin/contracts/access/extensions/AccessControlDefaultAdminRules.sol";
import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {SafeERC20} from "@openzeppelin/contracts/token/ERC20/utils/SafeERC20.sol";
import {DeviceRegistry} from "./DeviceRegistry.sol";
import {IDeviceRegistry} from "./interfaces/IDeviceRegistry.sol";
import {IMatchingPolicy} from "./interfaces/IMatchingPolicy.sol";
import {IOrganization} from "./interfaces/IOrganization.sol";
import {IServiceManager, ServiceState} from "./interfaces/IServiceManager.sol";
import {ITaskManager, TaskRequest} from "./interfaces/ITaskManager.sol";

contract Organization is IOrganization, DeviceRegistry, AccessControlDefaultAdminRules {
    using SafeERC20 for IERC20;

    bytes32 public constant OPERATOR_ROLE = keccak256("OPERATOR_ROLE");
    bytes32 public constant TREASURER_ROLE = keccak256("TREASURER_ROLE");
    bytes32 public constant ORACLE_ROLE = keccak256("ORACLE_ROLE");

    /// @dev What a policy may spend; the caller's transaction outlives one that needs more.
    uint256 private constant POLICY_GAS = 500_000;

    /// @inheritdoc IOrganization
    IERC20 public immutable token;
    /// @inheritdoc IOrganization
    IServiceManager public immutable services;
    /// @inheritdoc IOrganization
    ITaskManager public immutable tasks;
    /// @inheritdoc IOrganization
    IMatchingPolicy public policy;
    /// @inheritdoc IOrganization
    mapping(bytes32 kind => bool) public isKindAllowed;

    /// @param services_ may be deployed later, at this address; the same for `tasks_`, which checks it
    constructor(
        IERC20 token_,
        IServiceManager services_,
        ITaskManager tasks_,
        IMatchingPolicy policy_,
        address administrator
    ) AccessControlDefaultAdminRules(0, administrator) {
        token = token_;
        services = services_;
        tasks = tasks_;
        _setPolicy(policy_);
        // Rewards leave through registerTask alone, which only the operator can call here.
        token_.forceApprove(address(tasks_), type(uint256).max);
    }

    /// @inheritdoc IOrganization
    function allowKind(bytes32 kind, bool allowed) external onlyRole(DEFAULT_ADMIN_ROLE) {
        isKindAllowed[kind] = allowed;
        emit KindAllowed(kind, allowed);
    }

    /// @inheritdoc IOrganization
    function setPolicy(IMatchingPolicy policy_) external onlyRole(DEFAULT_ADMIN_ROLE) {
        _setPolicy(policy_);
    }

    /// @inheritdoc IDeviceRegistry
    function registerDevice(address device_, bytes32 role, address owner_)
        external
        onlyRole(DEFAULT_ADMIN_ROLE)
    {
        _registerDevice(device_, role, owner_);
    }

    /// @inheritdoc IDeviceRegistry
    function revokeDevice(address device_) external onlyRole(DEFAULT_ADMIN_ROLE) {
        _revokeDevice(device_);
    }

    /// @inheritdoc IOrganization
    function registerTask(TaskRequest calldata request) external onlyRole(OPERATOR_ROLE) returns (uint256) {
        return tasks.registerTask(request);
    }

    /// @inheritdoc IOrganization
    function cancelTask(uint256 taskId) external onlyRole(OPERATOR_ROLE) {
        tasks.cancelTask(taskId);
    }

    /// @inheritdoc IOrganization
    function submitProof(uint256 taskId, uint8 attempt, bytes32 proofHash, string calldata uri)
        external
        onlyRole(OPERATOR_ROLE)
    {
        tasks.submitProof(taskId, attempt, proofHash, uri);
    }

    /// @inheritdoc IOrganization
    function registerService(bytes32 kind, uint256 price, string calldata description)
        external
        onlyRole(OPERATOR_ROLE)
        returns (uint256)
    {
        return services.registerService(kind, price, description);
    }

    /// @inheritdoc IOrganization
    function updateService(uint256 serviceId, uint256 price, ServiceState state)
        external
        onlyRole(OPERATOR_ROLE)
    {
        services.updateService(serviceId, price, state);
    }

    /// @inheritdoc IOrganization
    function deposit(uint256 amount) external onlyRole(TREASURER_ROLE) {
        emit Deposited(msg.sender, amount);
        token.safeTransferFrom(msg.sender, address(this), amount);
    }

    /// @inheritdoc IOrganization
    function withdraw(address to, uint256 amount) external onlyRole(TREASURER_ROLE) {
        emit Withdrawn(to, amount);
        token.safeTransfer(to, amount);
    }

    /// @inheritdoc IOrganization
    function requireKind(bytes32 kind) external view {
        if (!isKindAllowed[kind]) revert UnknownKind(kind);
    }

    /// @inheritdoc IOrganization
    function isOracle(address account) external view returns (bool) {
        return hasRole(ORACLE_ROLE, account);
    }

    /// @inheritdoc IOrganization
    function selectService(bytes32 kind, uint256 reward)
        external
        view
        returns (uint256 serviceId, bool failed)
    {
        // A low-level call, because a malformed answer would revert here with `try`.
        (bool success, bytes memory answer) = address(policy).staticcall{gas: POLICY_GAS}(
            abi.encodeCall(IMatchingPolicy.serviceFor, (services, kind, reward))
        );
        if (!success || answer.length != 32) return (0, true);
        serviceId = abi.decode(answer, (uint256));
        if (serviceId != 0 && !services.isIdle(serviceId, kind, reward)) return (0, true);
    }

    function _setPolicy(IMatchingPolicy policy_) private {
        if (address(policy_).code.length == 0) revert InvalidPolicy(address(policy_));
        policy = policy_;
        emit PolicyChanged(policy_);
    }
}
