// SPDX-License-Identifier: MIT
pragma solidity ^0.8.28;

import {IOrganization} from "./interfaces/IOrganization.sol";
import {IServiceManager, Outcome, Service, ServiceState} from "./interfaces/IServiceManager.sol";
import {ITaskManager} from "./interfaces/ITaskManager.sol";
import {FirstFitQueue} from "./libraries/FirstFitQueue.sol";
import {KindTable} from "./libraries/KindTable.sol";
import {Units} from "./libraries/Units.sol";

contract ServiceManager is IServiceManager {
    using FirstFitQueue for FirstFitQueue.Queue;
    using KindTable for KindTable.Table;

    /// @dev A Service in two words.
    struct Record {
        address provider;
        uint96 price;
        uint64 taskId;
        uint64 place;
        uint16 kindId;
        ServiceState state;
        uint32 completed;
        uint32 rejected;
        uint32 expired;
    }

    /// @dev A place is the number of the offer, then the service's id in the low bits: unique and in order.
    uint256 private constant ID_BITS = 24;

    IOrganization public immutable organization;
    ITaskManager public immutable tasks;

    uint256 private _serviceCount;
    KindTable.Table private _kinds;
    mapping(uint256 serviceId => Record) private _services;
    /// @dev Those that wait for a task, in order; cheap ones weigh more (see Units.lightness).
    mapping(uint16 kindId => FirstFitQueue.Queue) private _idle;

    modifier onlyTaskManager() {
        if (msg.sender != address(tasks)) revert NotTaskManager(msg.sender);
        _;
    }

    constructor(IOrganization organization_, ITaskManager tasks_) {
        organization = organization_;
        tasks = tasks_;
    }

    /// @inheritdoc IServiceManager
    function registerService(bytes32 kind, uint256 price, string calldata description)
        external
        returns (uint256 serviceId)
    {
        organization.requireKind(kind);
        _requirePrice(price);
        serviceId = ++_serviceCount;
        assert(serviceId < 1 << ID_BITS);
        Record storage s = _services[serviceId];
        s.provider = msg.sender;
        s.price = uint96(price);
        s.kindId = _kinds.idOf(kind);
        s.state = ServiceState.Active;
        emit ServiceRegistered(serviceId, msg.sender, kind, price, description);
        tasks.placeService(serviceId, kind, price);
    }

    /// @inheritdoc IServiceManager
    function updateService(uint256 serviceId, uint256 price, ServiceState state) external {
        Record storage s = _get(serviceId);
        if (msg.sender != s.provider) revert NotProvider(serviceId, msg.sender, s.provider);
        if (s.state == ServiceState.Retired) revert ServiceIsRetired(serviceId);
        if (state == ServiceState.None) revert InvalidServiceState(state);
        _requirePrice(price);
        _leaveQueue(s);
        s.price = uint96(price);
        s.state = state;
        emit ServiceUpdated(serviceId, price, state);
        if (_isAvailable(s)) tasks.placeService(serviceId, _kinds.kinds[s.kindId], price);
    }

    /// @inheritdoc IServiceManager
    function acquire(uint256 serviceId, uint256 taskId)
        external
        onlyTaskManager
        returns (address provider, uint256 price)
    {
        Record storage s = _get(serviceId);
        if (!_isAvailable(s)) revert ServiceNotIdle(serviceId);
        _leaveQueue(s);
        s.taskId = uint64(taskId);
        return (s.provider, s.price);
    }

    /// @inheritdoc IServiceManager
    function release(uint256 serviceId, Outcome outcome)
        external
        onlyTaskManager
        returns (bool available, uint256 price)
    {
        Record storage s = _get(serviceId);
        s.taskId = 0;
        if (outcome == Outcome.Completed) ++s.completed;
        else if (outcome == Outcome.Rejected) ++s.rejected;
        else if (outcome == Outcome.Expired) ++s.expired;
        return (_isAvailable(s), s.price);
    }

    /// @inheritdoc IServiceManager
    function offer(uint256 serviceId) external onlyTaskManager {
        Record storage s = _get(serviceId);
        if (!_isAvailable(s) || s.place != 0) revert ServiceNotIdle(serviceId);
        FirstFitQueue.Queue storage idle = _idle[s.kindId];
        s.place = uint64((uint256(++idle.serial) << ID_BITS) | serviceId);
        idle.insert(s.place, Units.lightness(s.price));
    }

    /// @inheritdoc IServiceManager
    function service(uint256 serviceId) external view returns (Service memory) {
        Record storage s = _get(serviceId);
        return Service({
            provider: s.provider,
            price: s.price,
            kind: _kinds.kinds[s.kindId],
            taskId: s.taskId,
            place: s.place,
            state: s.state,
            completed: s.completed,
            rejected: s.rejected,
            expired: s.expired
        });
    }

    /// @inheritdoc IServiceManager
    function providerOf(uint256 serviceId) external view returns (address) {
        return _get(serviceId).provider;
    }

    /// @inheritdoc IServiceManager
    function serviceCount() external view returns (uint256) {
        return _serviceCount;
    }

    /// @inheritdoc IServiceManager
    function longestIdle(bytes32 kind, uint256 maxPrice) external view returns (uint256 serviceId) {
        return _idle[_kinds.ids[kind]].first(Units.lightness(maxPrice)) & ((1 << ID_BITS) - 1);
    }

    /// @inheritdoc IServiceManager
    function isIdle(uint256 serviceId, bytes32 kind, uint256 maxPrice) external view returns (bool) {
        Record storage s = _services[serviceId];
        return s.place != 0 && s.kindId == _kinds.ids[kind] && s.price <= maxPrice;
    }

    function _leaveQueue(Record storage s) private {
        if (s.place == 0) return;
        _idle[s.kindId].remove(s.place);
        s.place = 0;
    }

    function _isAvailable(Record storage s) private view returns (bool) {
        return s.state == ServiceState.Active && s.taskId == 0;
    }

    function _get(uint256 serviceId) private view returns (Record storage s) {
        s = _services[serviceId];
        if (s.provider == address(0)) revert UnknownService(serviceId);
    }

    function _requirePrice(uint256 price) private pure {
        if (!Units.isPrice(price)) revert InvalidPrice(price, Units.UNIT, Units.MAX);
    }
}
